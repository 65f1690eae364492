"""Numbers as people read them."""

from server.digits import number_text, round_above, round_below, short, written
from server.lane import Frame
from server.meter import Meter
from server.tables import sums_table


def test_numbers_are_short_and_without_needless_exponents():
    assert [number_text(v) for v in (1e4, 50.0, 0.2, 1e-4, 1e-6)] == ["10000", "50", "0.2", "0.0001", "1e-06"]
    assert [number_text(v, 2) for v in (99.0, 100.0, 412.0, 1e5)] == ["99", "100", "412", "100000"]
    assert [float(number_text(v)) for v in (1e7, 123456.0)] == [1e7, 123456.0]


def test_numbers_at_the_ends_of_scales_are_shorter():
    assert [short(v) for v in (1e4, 1.0, 0.02, 1e-6)] == ["10k", "1", "0.02", "10⁻⁶"]


def test_round_numbers_are_beside_their_value():
    assert [round_below(v) for v in (0.01, 0.015, 0.005, 0.003)] == [0.01, 0.01, 0.005, 0.002]
    assert [round_above(v) for v in (10.0, 11.0, 49.0, 51.0)] == [10.0, 20.0, 50.0, 100.0]


def test_exponents_for_reading_are_raised():
    values = (1e-6, 2.5e-7, -1e-8, -3e9, 0.2, float("nan"))
    assert [written(v) for v in values] == ["10⁻⁶", "2.5·10⁻⁷", "-10⁻⁸", "-3·10⁹", "0.2", "nan"]


def energies(**kinds):
    meter = Meter()
    meter.add(Frame(energy=kinds))
    return sums_table(["one"], [meter])


def test_energy_that_is_only_rounding_reads_zero():
    assert "<td>0</td>" in energies(kinetic=8.071e-47)
    assert "<td>0</td>" in energies(kinetic=2e-10, gravity=-0.5)
    assert "<td>2·10⁻¹⁰</td>" in energies(kinetic=2e-10, gravity=0.05)
    assert "<td>nan</td>" in energies(kinetic=float("nan"), gravity=0.05)
