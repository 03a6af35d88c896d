"""Places that a command names: clusters, and where on them to write, which every node must understand."""

from __future__ import annotations

from urllib.parse import urlsplit

from jobs.experiment.yaml_source import SpecError
from jobs.remote import DEFAULT_ADDRESS
from jobs.results.places import has_credentials, redacted


def ray_address(option: str, address: str) -> str:
    """The address of a Ray cluster: ``auto``, ``local``, ``HOST:PORT``, or ``ray://HOST:PORT``.

    Raises
    ------
    SpecError
        If it is none.
    """
    if address not in ("auto", "local") and not _has_host(f"//{address.removeprefix('ray://')}", needs_port=True):
        message = f"{option}: found {address!r}, expected auto or HOST:PORT"
        raise SpecError(message)
    return address


def dashboard_address(option: str, address: str) -> str:
    """The address of a cluster's dashboard, ``http://HOST:PORT``.

    Raises
    ------
    SpecError
        If it is none.
    """
    if not address.startswith(("http://", "https://")) or not _has_host(address, needs_port=False):
        message = f"{option}: found {address!r}, expected that of a dashboard, such as {DEFAULT_ADDRESS}"
        raise SpecError(message)
    return address


def _has_host(url: str, *, needs_port: bool) -> bool:
    """Whether there is a host, and a port that there can be."""
    if not url.isprintable() or " " in url:
        return False
    try:
        parts = urlsplit(url)
        return bool(parts.hostname) and (bool(parts.port) if needs_port else parts.port != 0)
    except ValueError:
        return False


def refuse_credentials(option: str, place: str) -> None:
    """Ray keeps the command line of every driver and job, and shows it to all who may list jobs.

    Raises
    ------
    SpecError
        If a place to write to holds a secret.
    """
    if has_credentials(place):
        message = (
            f"{option}: found credentials in {redacted(place)}, expected none: the command can be read by everybody "
            "who can see the dashboard; set AWS_ACCESS_KEY_ID and the like in the environment of the cluster's nodes"
        )
        raise SpecError(message)


def place_on_cluster(option: str, place: str) -> str:
    """A place to write to that every node understands.

    Raises
    ------
    SpecError
        If it is relative to this machine's current folder, or holds a secret.
    """
    refuse_credentials(option, place)
    if "://" not in place and not place.startswith("/"):
        message = f"{option}: found {place!r}, expected an absolute path on the cluster's nodes, or a URI"
        raise SpecError(message)
    return place
