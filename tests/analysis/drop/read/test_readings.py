"""Tables in the dialects that people and programs write."""

from pathlib import Path

import numpy as np
import openpyxl
import pytest

from analysis.drop.read.readings import Points, read_tables
from daq.importers.tables import read_sheets
from daq.setup.errors import InputError

TIMES = [1.5, 1.9, 2.26, 2.58]
EVENTS = {
    "semicolon, decimal comma": '"Ereigniszeit (s)";"Intervall (s)"\n1,5;0,4\n1,9;0,36\n2,26;0,32\n2,58;0\n',
    "tab, Italian": "Tempo evento (s)\tIntervallo (s)\n1,5\t0,4\n1,9\t0,36\n2,26\t0,32\n2,58\t0,0\n",
    "spaces": "1,5 0,4\n1,9 0,36\n2,26 0,32\n2,58 0,0\n",
    "quoted commas": '"Tijd (s)","Interval (s)"\n"1,5","0,4"\n"1,9","0,36"\n"2,26","0,32"\n"2,58","0"\n',
    "numbered rows": "n,Event time (s),Interval (s)\n1,1.5,0.4\n2,1.9,0.36\n3,2.26,0.32\n4,2.58,0\n",
    "times alone": "1.5\n1.9\n2.26\n2.58\n",
    "numbered, no intervals": '"#","Time (s)"\n1,1.5\n2,1.9\n3,2.26\n4,2.58\n',
    "milliseconds": "t (ms),Interval (ms)\n1500,400\n1900,360\n2260,320\n2580,0\n",
}
PATHS = {
    "Tracker": ("mass A\t\t\nt\tx\ty\n", "{t:.3f}\t0.1\t{y:.4f}\n", 1.0),
    "German": ("Zeit (s);x (cm);Höhe (cm)\n", "{t:.3f};10;{cm:.4f}\n", 1.0),
    "units below": ("t,x,y\ns,m,m\n", "{t:.3f},0.1,{y:.4f}\n", 1.0),
    "two lines above": ("mass A,,\nt (s),x (m),y (m)\n", "{t:.3f},0.1,{y:.4f}\n", 1.0),
    "exponents": ("mass A,,\nt,x,y\n", "{t:.3E},1.0E-1,{y:.6E}\n", 1.0),
    "speeds beside": ("t,y,vy,ay\ns,m,m/s,m/s^2\n", "{t:.3f},{y:.4f},2.5,-9.8\n", 1.0),
    "typographic minus": ("Zeit in s;Höhe in m\n", "{t:.3f};{y:.4f}\n", 1.0),
    "row numbers": (",time,height\n", "7,{t:.3f},{y:.4f}\n", 1.0),
    "no heading": ("", "{t:.3f} {y:.4f}\n", 1.0),
    "feet": ("time [s],height [ft]\n", "{t:.3f},{foot:.5f}\n", 1.0),
    "milliseconds and inches below": ("t,y\nms,in\n", "{ms:.1f},{inch:.4f}\n", 1.0),
    "spelt out": ("Elapsed seconds,Altitude in metres\n", "{t:.3f},{y:.4f}\n", 1.0),
}


@pytest.mark.parametrize("name", EVENTS)
def test_event_times_in_any_dialect(tmp_path: Path, name: str) -> None:
    """The same impacts come out of every dialect."""
    file = tmp_path / "events.csv"
    file.write_text(EVENTS[name], encoding="utf-8")
    assert read_tables(read_sheets(file), name).found[0][1] == pytest.approx(TIMES)


def test_intervals_alone_become_times(tmp_path: Path) -> None:
    """A lone column of intervals is summed; the first impact is at 0."""
    file = tmp_path / "intervals.csv"
    file.write_text("Intervall (s)\n0,4\n0,36\n0,32\n", encoding="utf-8")
    assert read_tables(read_sheets(file), "x").found[0][1] == pytest.approx([0.0, 0.4, 0.76, 1.08])


@pytest.mark.parametrize("name", PATHS)
def test_positions_in_any_dialect(tmp_path: Path, name: str) -> None:
    """Clock and height are found and scaled whatever they are called."""
    head, row, metre = PATHS[name]
    times = np.arange(20) / 100
    lines = [
        row.format(t=t, ms=1e3 * t, y=y, cm=100.0 * y, foot=y / 0.3048, inch=y / 0.0254)
        for t, y in zip(times, 1 - 4.9 * times**2, strict=True)
    ]
    if name in ("German", "typographic minus"):
        lines = [line.replace(".", ",").replace("-", "\N{MINUS SIGN}") for line in lines]
    file = tmp_path / "path.csv"
    file.write_text(head + "".join(lines), encoding="utf-8" if name == "typographic minus" else "latin-1")
    found = read_tables(read_sheets(file), name).found[0][1]
    assert isinstance(found, Points) and found.in_seconds
    assert found.clock == pytest.approx(times)
    assert found.y * metre == pytest.approx(1 - 4.9 * times**2, abs=1e-4)


def test_angles_are_no_heights(tmp_path: Path) -> None:
    """A column of degrees is refused as what it is; with a column of heights it is passed over."""
    for heading, more in (("time (s),elevation (deg)", ""), ("time (s),elevation (deg),height (m)", ",{h:.3f}")):
        file = tmp_path / "angle.csv"
        rows = [f"{t:.2f},{90 - 40 * t * t:.3f}" + more.format(h=20 - 4.9 * t * t) for t in np.arange(20) / 10]
        file.write_text("\n".join([heading, *rows]), encoding="utf-8")
        if more:
            found = read_tables(read_sheets(file), "x").found[0][1]
            assert isinstance(found, Points) and found.y[0] == 20.0
        else:
            with pytest.raises(InputError, match="angles are no heights"):
                read_tables(read_sheets(file), "x")


def test_distances_fallen_of_several_drops(tmp_path: Path) -> None:
    """Numbered columns of a distance that grows, with cells missing, are drops of one ball and no lists of times."""
    rows = ["t (s),distance 1 (m),distance 2 (m)"]
    rows += [
        f"{t:.2f},{4.9 * t * t:.4f},{'-' if k == 5 else f'{4.8 * t * t:.4f}'}" for k, t in enumerate(np.arange(30) / 20)
    ]
    file = tmp_path / "down.csv"
    file.write_text("\n".join(rows), encoding="utf-8")
    found = read_tables(read_sheets(file), "x").found
    assert [(name, len(path.y)) for name, path in found] == [("distance 1", 30), ("distance 2", 29)]


def test_heights_with_times_of_day_are_refused(tmp_path: Path) -> None:
    """Below a logger's own lines they are not taken for intervals, and plain seconds are asked for."""
    rows = [f"2026-05-01,12:00:{5 + k / 10:06.3f},{10 - 0.05 * k * k + 0.01 * (k % 2):.3f}" for k in range(12)]
    file = tmp_path / "stamps.csv"
    file.write_text("\n".join(["Logger 3000", "serial,1234", "Date,Time,Height m", *rows]), encoding="utf-8")
    with pytest.raises(InputError, match="times of day or dates"):
        read_tables(read_sheets(file), "x")


@pytest.mark.parametrize("separator", ["\t", " ", ","])
def test_imagej_tracks(tmp_path: Path, separator: str) -> None:
    """ImageJ's wide table gives every point of every track, blanks lost or kept, and no summary rows."""
    rows = [["Frame", "X1", "Y1", "Flag1", "X2", "Y2", "Flag2"], ["Tracks 1 to 2"]]
    for k in range(1, 21):
        other = ["*", "", "", ""] if k % 2 else ["", "50.5", "7.5", ""]
        rows.append([str(k), "10.5", f"{100 + k}.25", *other])
    summary = "\n\nTrack\tLength\tDistance traveled\tNr of Frames\n1\t917.3\t624.8\t370\n"
    text = "\n".join(separator.join(row) for row in rows) + summary
    file = tmp_path / "tracks.csv"
    file.write_text(text, encoding="utf-8")
    found = read_tables(read_sheets(file), "x").found[0][1]
    assert isinstance(found, Points) and not found.in_seconds
    assert len(found.y) == 30 and found.y.max() == 120.25


def test_a_workbook_with_localised_sheets(tmp_path: Path) -> None:
    """The sheet with event times is found by its content, behind others and under any name."""
    book = openpyxl.Workbook()
    book.active.title = "Einfach"
    book.active.append(["Start (s)", "Stopp (s)", "Differenz (s)"])
    book.active.append([1.5, 1.9, 0.4])
    sheet = book.create_sheet("Alle")
    sheet.append(["Ereigniszeit (s)", "Intervall (s)"])
    for row in zip(TIMES, [0.4, 0.36, 0.32, 0.0], strict=True):
        sheet.append(row)
    book.create_sheet("Metadaten Gerät").append(["version", "1.1.8"])
    book.save(tmp_path / "x.xlsx")
    assert read_tables(read_sheets(tmp_path / "x.xlsx"), "x").found[0][1] == pytest.approx(TIMES)


@pytest.mark.parametrize(
    "content", [b"PK\x03\x04broken", b"\xd0\xcf\x11\xe0broken", b"words only\n", b"\x00\x01\x02\x00"]
)
def test_what_is_no_table_is_refused(tmp_path: Path, content: bytes) -> None:
    """Damaged spreadsheets and files without numbers are refused with the file's name."""
    file = tmp_path / "odd.xls"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"odd\.xls"):
        read_sheets(file)
