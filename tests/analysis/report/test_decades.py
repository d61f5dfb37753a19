"""Texts of logarithmic axes."""

from matplotlib.figure import Figure

from analysis.report.decades import plain_decades, plain_number


def test_decades_are_plain_numbers() -> None:
    """Ticks read 0.01 or 100, and as powers of ten beyond what is quickly counted."""
    said = [plain_number(value) for value in (0.0, 0.01, 100.0, -100.0, 1e-6, -1e7, 2e-6)]
    assert said == ["0", "0.01", "100", "\u2212100", "10⁻⁶", "\u221210⁷", "2e-06"]


def test_ticks_between_decades_are_named_on_short_axes_alone() -> None:
    """Over less than a decade 2, 3 and more are named, as plain numbers; over three decades the decades alone."""
    ax = Figure().subplots()
    ax.set_yscale("log")
    plain_decades(ax.yaxis)
    ax.set_ylim(1.5, 6.0)
    minor = ax.yaxis.get_minor_formatter().format_ticks(ax.yaxis.get_minorticklocs())
    assert {"2", "3", "4"} <= set(minor) and not any("$" in text for text in minor)
    ax.set_ylim(1.0, 1000.0)
    assert not any(ax.yaxis.get_minor_formatter().format_ticks(ax.yaxis.get_minorticklocs()))
