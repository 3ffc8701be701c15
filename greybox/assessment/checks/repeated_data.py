"""Whether data are fitted twice, such as a file that was given twice."""

from itertools import combinations

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.grouping import grouped
from greybox.data.files.wording import listed
from greybox.data.record import share_samples
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.response_part import ResponsePart


def repeated_data(evidence: Evidence) -> Findings:
    """Name data that are fitted twice, such as a file that was given twice."""
    nlp = evidence.nlp
    pairs = [
        (group[0].name, again.name, "points")
        for group in grouped(nlp.parts_of(ResponsePart), lambda part: part.data.checksum)
        for again in group[1:]
    ]
    for first, again in combinations(nlp.parts_of(RecordPart), 2):
        earlier, later = first.model.record, again.model.record
        outputs = {*first.outputs} & {*again.outputs}
        if outputs and earlier.checksum == later.checksum and share_samples(earlier, later):
            pairs.append((first.name, again.name, f"samples of {listed(sorted(outputs))}"))

    for first, name, numbers in pairs:
        yield Finding(
            f"{first!r} and {name!r} have the same {numbers}, which count twice: the standard "
            "errors are too small; leave one of them out.",
            "repeated",
            name,
        )
