"""Effects of ArduPilot on signals and tests, from the parameters in the log.

Begin with `signals`.

| file | contents |
| --- | --- |
| `signals` | controls, sensors and setpoints of an axis; axes of System Identification mode |
| `filters` | filters of the gyro and of the rate controllers |
| `motors` | resolution and limits of the motor outputs |
| `truncated_angles` | half a hundredth of a degree that the log cuts off |
"""
