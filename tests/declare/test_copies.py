"""Copies of frozen parts are those of `dataclasses.replace`; what a kind of energy claims is proved later."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from phfmu import PHDAE, DeclarationError, build_model, energy, state
from phfmu.components.electrical import rlc_load
from phfmu.declare.entries.copies import copied


def test_a_copy_has_the_fields_of_the_original_but_for_those_changed():
    model = rlc_load(2.0, 0.1, 1e-3)
    for item, changes in [
        (model.states[0], {"name": "other"}),
        (model.ports[0], {"name": "other", "start": (1.0, 2.0, 3.0)}),
        (model.energies[0], {"owner": "other"}),
        (model.dissipation[0], {"owner": "other"}),
        (model, {"name": "other"}),
    ]:
        new, exact = copied(item, **changes), replace(item, **changes)
        assert type(new) is type(item) and new is not item
        for f in fields(item):
            assert getattr(new, f.name) is getattr(exact, f.name) or getattr(new, f.name) == getattr(exact, f.name)
            if f.name not in changes:
                assert getattr(new, f.name) is getattr(item, f.name)


def test_a_copy_is_as_frozen_as_the_original():
    with pytest.raises(AttributeError):
        copied(state("x"), name="y").name = "z"  # type: ignore[misc]


def test_an_energy_said_to_be_quadratic_is_the_one_recognised():
    x = state("x", start=1.0)
    (said,), (found,) = (
        PHDAE("one", (x,), energies=(e,)).energies for e in (energy(x**2, kind="quadratic"), energy(x**2))
    )
    assert said.kind is found.kind


def test_an_energy_said_to_be_quadratic_that_is_not_is_refused():
    x = state("x", start=1.0)
    with pytest.raises(DeclarationError, match="not quadratic"):
        build_model(PHDAE("one", (x,), energies=(energy(x**4, kind="quadratic"),)))
