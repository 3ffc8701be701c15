"""Shows fits, and hands them on.

| folder | contents |
| --- | --- |
| `interop/` | to and from other libraries and languages |
| `plotting/` | figures |
| `html_report/` | one page about fits, for a colleague |
"""
