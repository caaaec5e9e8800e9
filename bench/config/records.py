"""Which methods serve a measured record where none is named: ``conf/records.yaml``."""

from __future__ import annotations

from typing import Any

from bench.config.files import read_yaml


def primary_method() -> str:
    """The one whose answer is stated."""
    return str(_said("primary"))


def robust_settings(method: str) -> dict[str, Any]:
    """The settings by which a method expects outliers; none where it has no such settings."""
    return dict(_said("robust").get(method, {}))


def certificate_methods() -> list[str]:
    """Those that a certificate compares, the primary one first."""
    return list(_said("certificate"))


def track_methods() -> list[str]:
    """Those of the measured track."""
    return list(_said("track"))


def _said(name: str) -> Any:
    return read_yaml("", "records")[name]
