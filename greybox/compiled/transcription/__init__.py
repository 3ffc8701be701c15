"""How a problem in time becomes one of optimization: one method a file, interchangeable on one problem."""

from greybox.compiled.transcription.collocation import Collocation as Collocation
from greybox.compiled.transcription.method import Transcription as Transcription
from greybox.compiled.transcription.multiple_shooting import MultipleShooting as MultipleShooting
from greybox.compiled.transcription.single_shooting import SingleShooting as SingleShooting
