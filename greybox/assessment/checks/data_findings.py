"""What the reader of a log found: restarts of the clock, lost lines, misspelled units."""

import re
from collections.abc import Iterator

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.record import Record
from greybox.data.units import known_unit, misspelled
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.modeling.model import Model


def data_findings(evidence: Evidence) -> Findings:
    """Repeat the findings of the log reader: restarts of the clock, lost lines."""
    return findings_of_data(evidence.nlp)


def findings_of_data(nlp: CompiledProblem) -> Findings:
    """Repeat the findings of the log reader: restarts of the clock, lost lines."""
    for part in nlp.problem.parts_with(Record):
        for text in (*part.data.findings, *_misspelled_units(part.model, part.data)):
            # What a unit was taken for is certain where the model declares it.
            if text.partition(":")[0] in part.model.units:
                continue
            # Findings of one kind differ in their numbers.
            kind = re.sub(r"[\d.]+", "", text)
            yield Finding(f"data of {part.name!r}: {text}", kind, part.name)


def _misspelled_units(model: Model, data: Record) -> Iterator[str]:
    for name in (*model.input_names, *model.output_names):
        unit = data.units.get(name, "")
        if known_unit(unit) is None and (text := misspelled(unit)):
            yield f"{name}: {text}."
