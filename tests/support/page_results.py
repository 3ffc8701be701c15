"""Small results for the page, and one whose names a stranger wrote."""

from dataclasses import replace
from functools import cache

import numpy as np

import greybox as gb
from greybox.data.record import Record
from greybox.models.polynomial import Polynomial

MARKUP = '<img src=x onerror="pwned=1"></script><script>pwned=1</script>&amp;\'"'


@cache
def lag(name="lag", seed=0):
    """A lag fitted to a response with coherence and variance and to a record."""
    rng = np.random.default_rng(seed)
    omega = np.geomspace(1, 20, 12)
    noise = 0.02 * (rng.normal(size=12) + 1j * rng.normal(size=12)) / np.sqrt(2)
    true = 2 / (1j * omega + 3)
    response = gb.FrequencyResponse(
        omega,
        true * (1 + noise),
        input="u",
        output="y",
        coherence=np.linspace(0.99, 0.9, 12),
        variance=(0.02 * np.abs(true)) ** 2,
        name="sweep",
        source="sweep.csv",
    )
    time = 0.05 * np.arange(200)
    u = np.sin(2 * time)
    y = gb.simulate(Polynomial(1, 0), {"b0": 2.0, "a0": 3.0}, Record(time, {"u": u}))["y"]
    record = Record(
        time, {"u": u, "y": y + 0.01 * rng.normal(size=200)}, {"y": "rad"}, name="flight"
    )
    model = Polynomial(1, 0)
    both = gb.Problem(model, response, gb.MaximumLikelihood(), name=name) + gb.Problem(
        model, record
    )
    return gb.fit(both, starts=3, seed=0, progress=False)


def crafted(fit):
    """The fit with markup in every text, and of a class that nobody has."""
    response, record = fit.parts
    texts = dict.fromkeys(("name", "rule", "condition", "delay", "label", "equation"), MARKUP)
    model = {"class": f"{MARKUP}:{MARKUP}", "arguments": [], "keywords": {}}
    parts = (
        replace(
            response, **texts, model=model, data=replace(response.data, name=MARKUP, source=MARKUP)
        ),
        replace(
            record, **texts, model=model, data=replace(record.data, name=MARKUP, source=MARKUP)
        ),
    )
    return replace(
        fit,
        name=MARKUP,
        parts=parts,
        quantities=tuple(replace(q, unit=MARKUP, about=MARKUP) for q in fit.quantities),
        warnings=(MARKUP,),
        notes=(MARKUP,),
        starts=MARKUP,
        versions={MARKUP: MARKUP},
        command=("fit", "; rm -rf ~"),
        models=None,
    )
