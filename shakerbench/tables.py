"""Tables of numbers with their units, as pandas and xarray take them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Table(Mapping[str, NDArray[Any]]):
    """Columns of equal length by name, with their units.

    Parameters
    ----------
    columns : mapping of str to array, shape (n,)
        In order.
    units : mapping of str to str
        By column; ``1`` where a column is dimensionless, empty where it holds words.
    attrs : mapping
        What belongs to the whole table.
    row : str
        Name of the dimension of the rows in xarray.

    Examples
    --------
    >>> import numpy as np
    >>> Table({"gamma": np.array([0.9, 1.1])}, {"gamma": "1"})["gamma"]
    array([0.9, 1.1])
    """

    columns: Mapping[str, NDArray[Any]]
    units: Mapping[str, str]
    attrs: Mapping[str, Any] = field(default_factory=dict)
    row: str = "row"

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The column ``name``."""
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        """Over the names of the columns."""
        return iter(self.columns)

    def __len__(self) -> int:
        """Number of columns; of rows: ``n_rows``."""
        return len(self.columns)

    def __repr__(self) -> str:
        """Rows and columns with their units, not the numbers."""
        named = (f"{name} ({self.units[name]})" if self.units.get(name) else name for name in self.columns)
        return f"<{type(self).__name__}: {self.n_rows} rows of {', '.join(named)}>"

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def to_dataframe(self) -> Any:
        """The table as a `pandas.DataFrame`; units in ``.attrs["units"]``, by column.

        Raises
        ------
        ImportError
            Where pandas is not installed (``pip install shakerbench[dataframes]``).
        """
        import pandas as pd

        frame = pd.DataFrame(dict(self.columns))
        frame.attrs = {**self.attrs, "units": dict(self.units)}
        return frame

    def to_xarray(self) -> Any:
        """The table as an `xarray.Dataset` along the dimension ``row``; units in each variable's ``attrs["units"]``.

        Raises
        ------
        ImportError
            Where xarray is not installed (``pip install shakerbench[dataframes]``).
        """
        import xarray as xr

        variables = {name: (self.row, np.asarray(x), {"units": self.units[name]}) for name, x in self.columns.items()}
        return xr.Dataset(variables, attrs=dict(self.attrs))
