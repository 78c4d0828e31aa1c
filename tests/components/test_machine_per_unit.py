"""Machine sets from books and grid files: circuits and reactances in per unit, and what contradicts itself."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phfmu.components.electrical import (
    MachineDataError,
    from_inductances,
    from_per_unit,
    machine_set,
    reactances,
    steady_state,
    synchronous_machine,
)
from tests.components.orders import steps

RATED: Any = {"Sn": 100e6, "Vn_rms_ll": 16.5e3, "fn": 60.0}
GENROU: Any = {"xl": 0.1, "xd": 1.8, "xq": 1.7, "xd1": 0.3, "xq1": 0.55, "xd2": 0.25,
          "Td10": 8.0, "Td20": 0.03, "Tq10": 0.4, "Tq20": 0.05}  # fmt: skip
CIRCUITS = {"kundur555_1q": 3.525, "krause_hydro325": 7.5}


@pytest.mark.parametrize("name", CIRCUITS)
def test_the_built_in_sets_follow_from_the_circuits_of_their_books(name):
    built = machine_set(name)
    pu = _file(name)["pu"]
    current = math.sqrt(2 / 3) * built.Vn_rms_ll / (built.omega * built.M_stator_rotor[0])
    made = from_per_unit(
        name, Sn=built.Sn, Vn_rms_ll=built.Vn_rms_ll, fn=built.fn, H=CIRCUITS[name], no_load_field_current=current,
        ra=pu["ra"], xl=pu["ll"], x0=pu["l0"], xad=pu["lad"], xaq=pu["laq"], rotor_d=pu["d_rot"], rotor_q=pu["q_rot"],
    )  # fmt: skip
    for entry in ("Ra", "Ld", "Lq", "L0", "M_stator_rotor", "R_rotor", "L_rotor"):
        assert np.allclose(getattr(made, entry), getattr(built, entry), rtol=1e-12, atol=1e-18), entry
    assert made.J == pytest.approx(built.J, rel=1e-9)
    assert made.axis == built.axis


def test_reactances_of_the_kundur_machine_are_those_of_the_book():
    """Kundur 1994, table 4.2: xd' .30, xd'' .23, Td0' 8.0 s, Td0'' .03 s, by the classical definitions rounded."""
    found = reactances("kundur555_1q")
    assert found["xd"] == pytest.approx(1.81, abs=5e-3) and found["xq"] == pytest.approx(1.76, abs=5e-3)
    assert found["xd1"] == pytest.approx(0.30, abs=5e-3) and found["xd2"] == pytest.approx(0.23, abs=5e-3)
    assert found["Td10"] == pytest.approx(8.07, abs=0.1) and found["Td20"] == pytest.approx(0.03, abs=5e-4)


shares = st.floats(0.05, 0.95)


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[shares] * 6), st.floats(0.01, 0.3), st.floats(0.5, 2.5), st.sampled_from([None, 300.0]))
def test_reactances_go_round(share, xl, above, current):
    xd, xq = xl + above, xl + above * share[0]
    xd2, xq2 = (xl + share[1] * share[2] * x for x in (xd - xl, xq - xl))
    data = {
        "xl": xl, "xd": xd, "xq": xq, "xd1": xl + share[1] * (xd - xl), "xq1": xl + share[1] * (xq - xl),
        "xd2": xd2, "xq2": xq2, "Td10": 1 + 9 * share[3], "Td20": 0.02 + share[4] / 10, "Tq10": 0.2 + share[5],
        "Tq20": 0.02 + share[3] / 10,
    }  # fmt: skip
    found = reactances(from_per_unit("m", H=3.0, ra=0.003, no_load_field_current=current, **RATED, **data))
    for key, value in data.items():
        if key != "xl":
            assert found[key] == pytest.approx(value, rel=1e-12 / min(share) ** 2), key


def test_gensal_has_one_damper_on_each_axis():
    sal = {k: v for k, v in GENROU.items() if k not in ("xq1", "Tq10")}
    data = from_per_unit("m", "GENSAL", H=3.0, **RATED, **sal)
    assert data.axis == ("d", "d", "q")
    found = reactances(data)
    assert found["xq2"] == pytest.approx(0.25, rel=1e-12) and found["Tq20"] == pytest.approx(0.05, rel=1e-12)
    assert "xq1" not in found


def test_gencls_keeps_a_voltage_behind_its_transient_reactance():
    """After a short circuit at no load without resistance the peak of the ac current is E/xd1 for ever."""
    data = from_per_unit("m", "GENCLS", H=1e4, xd1=0.25, **RATED)
    start = steady_state(data, 0.0, 0.0)
    unit, _ = steps(synchronous_machine(data, start=start), 3, 1e-4, 2042, lambda t: [0.0, 0.0, 0.0, start.Vf, 0.0])
    x = unit.signals()["x"]
    current = np.linalg.solve(data.constant_inductance(), x[: data.n])[:2]
    flux, angle = data.Vn_rms_ll / data.omega, x[data.n + 1] - start.theta  # orthonormal coordinates
    # without resistance the stator keeps its flux in space and the field the voltage behind xd1, which is the rated one
    kept = flux * np.array([np.cos(angle) - 1, -np.sin(angle)])
    assert current == pytest.approx(kept * data.omega / 0.25 / (data.Vn_rms_ll**2 / data.Sn), rel=1e-7)


def test_pole_pairs_and_both_ways_to_give_the_inertia():
    one = from_per_unit("m", H=3.0, D=2.0, **RATED, **GENROU)
    four = from_per_unit("m", H=3.0, D=2.0, pole_pairs=4, model="GENROU", **RATED, **GENROU)
    assert four.J == pytest.approx(16 * one.J) and four.J_electrical == pytest.approx(one.J_electrical)
    assert four.d_electrical == pytest.approx(one.d_electrical)
    assert one.J * one.omega**2 / 2 / one.Sn == pytest.approx(3.0)
    assert one.d * one.omega**2 / one.Sn == pytest.approx(2.0)
    assert from_per_unit("m", J=four.J, pole_pairs=4, model="GENROU", **RATED, **GENROU).J == four.J


def test_inductances_in_si_are_the_same_machine():
    base = RATED["Vn_rms_ll"] ** 2 / RATED["Sn"]
    w = 2 * math.pi * RATED["fn"]
    pu = from_per_unit("m", J=1e4, ra=0.003, xl=0.1, xad=1.7, xaq=1.6, rotor_d=[(6e-4, 0.16), (0.02, 0.17)],
                       rotor_q=[(0.02, 0.1)], **RATED)  # fmt: skip
    si = from_inductances("m", J=1e4, Ra=0.003 * base, Ll=0.1 * base / w, Lmd=1.7 * base / w, Lmq=1.6 * base / w,
                          rotor_d=[(6e-4 * base, 0.16 * base / w), (0.02 * base, 0.17 * base / w)],
                          rotor_q=[(0.02 * base, 0.1 * base / w)], **RATED)  # fmt: skip
    assert np.allclose(si.constant_inductance(), pu.constant_inductance(), rtol=1e-13)
    assert np.allclose(si.R_rotor, pu.R_rotor, rtol=1e-13)


def test_a_winding_without_room_is_left_out_and_told():
    with pytest.warns(UserWarning, match=r"machine 'm': the q axis has 1.7 pu twice"):
        data = from_per_unit("m", H=3.0, **RATED, **(GENROU | {"xq1": 1.7}))
    assert data.axis == ("d", "d", "q") and reactances(data)["xq2"] == pytest.approx(0.25, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"xd2": 0.09}, "xd2 = 0.09 is not above the leakage xl = 0.1"),
        ({"xd1": 0.2}, "xd2 = 0.25 is above xd1 = 0.2"),
        ({"xq1": 1.9}, "xq1 = 1.9 is above xq = 1.7"),
        ({"xd1": 1.8}, "xd1 = xd = 1.8 leaves no field winding"),
        ({"Td10": None}, "missing: Td10"),
        ({"td10": 5.0}, "unknown entry 'td10'; did you mean Td10?"),
        ({"Tq20": -1.0}, "Tq20 = -1 must be positive"),
        ({"ra": -1e-3}, "ra = -0.001 must be positive"),
        ({"xl": "a"}, "xl = 'a' is no number"),
        ({"H": None}, "H = None s and J = None kg m2; give one of them"),
        ({"Sn": 0.0}, "Sn = 0.0 must be positive"),
    ],
)
def test_data_that_contradict_themselves_are_told_with_their_numbers(change, words):
    with pytest.raises(MachineDataError) as failed:
        from_per_unit("m", **(RATED | {"H": 3.0} | GENROU | change))
    assert words in str(failed.value) and "machine 'm'" in str(failed.value)


def test_unknown_model_is_told_with_the_known_ones():
    with pytest.raises(MachineDataError, match="no model 'GENTPJ'"):
        from_per_unit("m", "GENTPJ", H=3.0, **RATED, **GENROU)


def _file(name):
    from phfmu.components.electrical.machines.machine_data import _file as sets

    return sets()[name]
