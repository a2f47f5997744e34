"""Policy tables as xarray datasets with labelled axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from collections.abc import Mapping

    import xarray
    from numpy.typing import NDArray

__all__ = ["labelled_dataset"]


def labelled_dataset(
    arrays: Mapping[str, tuple[NDArray[Any], str, str]],
    axes: Mapping[str, tuple[NDArray[Any], str]],
    scenario: Any,
    table_digest: str,
) -> xarray.Dataset:
    """Return an xarray dataset of arrays over axes.

    `arrays` holds array, description and unit by name, `axes` the points and their unit. Raises InputError if xarray is
    not installed.
    """
    try:
        import xarray
    except ImportError:
        rule = "needs xarray: install it with `pip install needleplan[xarray]`"
        raise InputError(Mistake("to_xarray", "", rule)) from None
    return xarray.Dataset(
        {
            name: (tuple(axes), array, {"long_name": description, "units": unit})
            for name, (array, description, unit) in arrays.items()
        },
        coords={name: (name, points, {"units": unit}) for name, (points, unit) in axes.items()},
        attrs={"title": scenario.title, "digest": table_digest, "scenario": scenario.to_toml()},
    )
