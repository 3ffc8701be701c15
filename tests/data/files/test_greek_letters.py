"""Names of Greek letters."""

from greybox.data.files.greek_letters import in_greek


def test_names_of_greek_letters():
    names = "theta", "u_phi", "Omega_x", "lambda_0", "PI", "thetas", "fitted alpha_1"
    assert [*map(in_greek, names)] == ["θ", "u_φ", "Ω_x", "λ_0", "PI", "thetas", "fitted α_1"]
