"""Declarations of an ODE: what is refused when it is declared."""

import pytest

import greybox as gb


def declare(**body):
    functions = {
        "derivative": lambda self, x, u, p: (-x.x,),
        "output": lambda self, x, u, p: (x.x,),
    }
    return type("Broken", (gb.StateSpace,), {"states": ("x",), **functions, **body})


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        (
            {"inputs": ("u", "u")},
            r"Broken\.inputs = \('u', 'u'\) must be a tuple of different names",
        ),
        ({"inputs": ("x",)}, r"Broken has 'x' as input and as state or output: use two names"),
        ({"outputs": ("u",)}, r"Broken has 'u' as input and as state or output"),
        ({"delays": {"v": "T"}}, r"Broken\.inputs has no input 'v'; it has u"),
        ({"delays": {"u": "T"}}, r"Broken has no parameter 'T'; it has none"),
    ],
)
def test_a_wrong_declaration_is_refused_when_it_is_made(body, sentence):
    with pytest.raises(ValueError, match=sentence):
        declare(**body)


def test_states_need_a_derivative():
    with pytest.raises(
        TypeError, match=r"Broken has states but no derivative\(self, x, u, p\): declare it"
    ):
        declare(derivative=gb.StateSpace.derivative)


@pytest.mark.parametrize("name", ["keys", "values"])
@pytest.mark.parametrize("kind", ["states", "inputs"])
def test_a_signal_may_not_hide_what_the_framework_calls(kind, name):
    with pytest.raises(ValueError, match=f"Broken .*{name!r}.*another name"):
        declare(**{kind: (name,)})
