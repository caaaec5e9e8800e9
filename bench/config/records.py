"""Default methods for measured records, from ``conf/records.yaml``."""

from __future__ import annotations

from typing import Any

from bench.config.files import read_yaml


def primary_method() -> str:
    """Return the method whose estimate is reported."""
    return str(_content()["primary"])


def robust_settings(method: str) -> dict[str, Any]:
    """Return the settings that make a method robust against outliers; empty if it has none."""
    return dict(_content()["robust"].get(method, {}))


def default_method() -> str:
    """Return the default method of a measured record: the first of a certificate whose packages are installed."""
    from bench.entrants.registry import missing_package, registered

    names = [name for name in certificate_methods() if name in registered()]
    return next((name for name in names if not missing_package(name)), primary_method())


def certificate_methods() -> list[str]:
    """Return the methods that a certificate compares, the primary method first."""
    return list(_content()["certificate"])


def track_methods() -> list[str]:
    """Return the methods of the measured track."""
    return list(_content()["track"])


def _content() -> dict[str, Any]:
    return read_yaml("", "records")
