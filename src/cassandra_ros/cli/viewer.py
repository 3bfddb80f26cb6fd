# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Show stored topics in a browser; the server also has an API, and sends time ranges as bags.

  rosrun cassandra_ros viewer
  rosrun cassandra_ros viewer --keyspace field --port 9000 --open
  rosrun cassandra_ros viewer --host 0.0.0.0
  rosrun cassandra_ros viewer --store home --store husky:9042

It prints the address to open, and runs until Ctrl-C. It does not change stored data. By default
only this machine can connect: all its users, or, if you log in to the store, those with the token
at the end of the address. With --host other machines can, too; they always need the token. It is
sent unencrypted: in networks that you do not trust, put a TLS proxy in front of the viewer, or use
'ssh -L'.

With --store, given once or several times, all these stores are shown as one on Home, Ask and Look.
A store that does not answer is named on the page. The Map, SQL, plans, files of time ranges and new
events ask one store: start a viewer of that store, with --store-host.

doc/viewer.md describes the pages, the API, and how Foxglove, Lichtblick and curl use it.
"""

from __future__ import annotations

import argparse
import secrets
import sys
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Callable, Sequence

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.confirmation import person_reads, says_yes
from cassandra_ros.cli.fleet_options import (
    add_fleet_options,
    open_fleet,
    refuse_single_store_options,
    tell_missing,
)
from cassandra_ros.cli.options import (
    add_store_options,
    open_store,
    read_port,
    strip_remappings,
    without_empty,
)
from cassandra_ros.cli.parsers import error_line, program_parser
from cassandra_ros.errors import DownloadFailed, InvalidOption, KeyspaceNotFound
from cassandra_ros.installation import optional_module
from cassandra_ros.quantities import byte_size
from cassandra_ros.store.connection.address import from_environment
from cassandra_ros.store.connection.login import is_private, read_login
from cassandra_ros.viewing.studio import (
    STUDIO_VERSION,
    install_studio,
    studio_folder,
    studio_installed,
)
from cassandra_ros.viewing.viewer_settings import (
    DEFAULT_CACHE_BYTES,
    DEFAULT_HOST,
    DEFAULT_PORT,
    ViewerSettings,
)

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.stores.fleet.fleet import Fleet
    from cassandra_ros.topics.catalog import Catalog

PROGRAM = "viewer"
TOKEN_BYTES = 18
"""Number of random bytes of a token that is made."""


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = program_parser(PROGRAM, __doc__)
    add = parser.add_argument
    text = f"port of the HTTP server; 0 = any free port (default: {DEFAULT_PORT})"
    add("--port", dest="listen_port", type=_listen_port, default=DEFAULT_PORT, help=text)
    add(
        "--host",
        dest="listen_host",
        metavar="ADDRESS",
        default=DEFAULT_HOST,
        help="address of this machine to listen on; 0.0.0.0 = all addresses (default: "
        f"{DEFAULT_HOST}, which only this machine can reach)",
    )
    _add_token_options(parser.add_mutually_exclusive_group().add_argument)
    add(
        "--allow-origin",
        metavar="ORIGIN",
        action="append",
        default=[],
        help="allow pages of another site to read, for example https://app.foxglove.dev; may be "
        "repeated",
    )
    text = "allow clients to add events (default: the viewer only reads)"
    add("--allow-writes", action="store_true", help=text)
    text = "download Foxglove Studio for the page Look from npm's registry (37 MB), and end"
    add("--install-studio", action="store_true", help=text)
    text = (
        "open it in the browser of this machine; while the browser starts, other users see the "
        "address with its token in the list of processes"
    )
    add("--open", action="store_true", help=text)
    add(
        "--cache",
        metavar="DIR",
        help="folder for bags that are being sent (default: a new folder for temporary files)",
    )
    text = f"maximum size of this folder, for example 500M or 20G (default: {DEFAULT_CACHE_BYTES})"
    add("--cache-size", metavar="SIZE", type=byte_size, default=DEFAULT_CACHE_BYTES, help=text)
    add_store_options(parser, prefix="store-")
    add_fleet_options(parser, prefix="store-", ends=False)
    parser.set_defaults(parser=parser)
    return parser


def _add_token_options(add: Callable[..., object]) -> None:
    text = (
        "secret that clients must send. Other users of this machine see it in the list of "
        "processes, but not that of --token-file and of the variable CASSANDRA_ROS_TOKEN (default: "
        "that of the variable, else a new one at each start if --host lets other machines connect, "
        "or if you log in to the store with a password or a key)"
    )
    add("--token", metavar="TEXT", help=text)
    text = (
        "file with this secret in its first line, which only you may read, mode 600; /dev/fd/3 = "
        "from descriptor 3 (default: no file)"
    )
    add("--token-file", metavar="FILE", help=text)
    text = "let all users of this machine read the store, though you log in to it"
    add("--no-token", action="store_true", help=text)


def _listen_port(text: str) -> int:
    return 0 if text == "0" else read_port(text)


def read_settings(options: argparse.Namespace) -> ViewerSettings:
    """Return the settings of the server; raises InvalidOption like _token."""
    return ViewerSettings(
        host=options.listen_host,
        port=options.listen_port,
        token=_token(options),
        allow_origin=tuple(origin.rstrip("/") for origin in options.allow_origin),
        allow_writes=options.allow_writes,
        cache=Path(options.cache) if options.cache else None,
        cache_bytes=options.cache_size,
    )


def _token(options: argparse.Namespace) -> str:
    """Return the token that clients must send; '' = none is needed.

    If none is given one is made where other machines can connect, or where other users of this
    machine could read a store that requires a login.

    Raises:
        InvalidOption: The file of the token, or one of the login, cannot be used.
    """
    from cassandra_ros.viewing.security import is_loopback

    reached = not is_loopback(options.listen_host)
    if options.no_token:
        if reached:
            options.parser.error(
                f"--no-token: other machines reach {options.listen_host} and could read all stored "
                "messages; leave out --no-token or --host"
            )
        return ""
    token = read_token(options.token_file) if options.token_file else options.token
    token = token or from_environment("TOKEN")
    if not token and (reached or _logs_in(options)):
        token = secrets.token_urlsafe(TOKEN_BYTES)
    return token


def read_token(name: str) -> str:
    """Return the first line of a file, without blanks at its ends.

    Raises:
        InvalidOption: It cannot be read, is empty, or others can read the file.
    """
    if not is_private(name):
        raise InvalidOption(
            f"--token-file {name}: others can read it, or it belongs to another user; make it "
            f"yours alone: chmod 600 {name}"
        )
    try:
        with open(name, encoding="utf-8") as file:
            token = file.readline().strip()
    except (OSError, UnicodeDecodeError) as exc:
        reason = getattr(exc, "strerror", None) or "it is not UTF-8"
        raise InvalidOption(f"--token-file {name} cannot be read: {reason}") from exc
    if not token:
        raise InvalidOption(f"--token-file {name}: its first line is empty; write the token there")
    return token


def _logs_in(options: argparse.Namespace) -> bool:
    """Return whether a password or a key is used for the store, or for one of several stores."""
    cqlshrc, credentials = options.cqlshrc, options.credentials
    if not options.stores:
        return read_login(options.host, options.port, cqlshrc, credentials).is_secret
    from cassandra_ros.stores.fleet.fleet_store import read_places

    names, file = options.stores, options.store_file
    places = read_places(names, file, options.keyspace, cqlshrc, credentials)
    return any(read_login(p.host, p.port, p.cqlshrc, p.credentials).is_secret for p in places)


def main(argv: Sequence[str] | None = None) -> int:
    """Serve until Ctrl-C; return the exit status."""
    parser = make_parser()
    answer_shell(parser)
    options = parser.parse_args(without_empty(strip_remappings(argv)))
    if options.install_studio:
        install(studio_folder())
        return 0
    optional_module("aiohttp", "the viewer")
    from cassandra_ros.viewing.viewer_server import serve

    settings = read_settings(options)
    offer_studio(PROGRAM, settings.studio)
    with _open_stores(options) as source:

        def ready(address: str) -> None:
            what = f"keyspace {options.keyspace} is"
            if options.stores:
                what = f"the fleet of {', '.join(options.stores)} is"
            print(f"{what} at {address} (Ctrl-C ends it)", flush=True)
            if options.open:
                threading.Thread(target=webbrowser.open, args=[address], daemon=True).start()

        serve(settings, source, ready)
    return 0


def _open_stores(options: argparse.Namespace) -> RosCassandra | Fleet:
    """Connect to the store, or to several stores, and warn if there is nothing to show."""
    if options.stores:
        refuse_single_store_options(options, {"--allow-writes": options.allow_writes})
        fleet = open_fleet(options)
        tell_missing(fleet.topics().missing, PROGRAM)
        return fleet
    # The viewer may be started before the recorder creates the keyspace.
    ros_cas = open_store(options, make=True)
    _warn_if_missing(ros_cas.catalog)
    return ros_cas


def _warn_if_missing(catalog: Catalog) -> None:
    """Warn if the keyspace does not exist: its name may be misspelt."""
    try:
        catalog.keyspace.side_tables.require_keyspace()
    except KeyspaceNotFound as exc:
        print(error_line(PROGRAM, f"{exc}; it is shown once it is there"), file=sys.stderr)


COMMAND = "rosrun cassandra_ros viewer --install-studio"
_DECLINED = "declined"
"""Name of the empty file that marks that the user does not want the Studio."""


def install(folder: Path) -> None:
    """Download the Studio if it is missing, and print its folder.

    Raises:
        DownloadFailed: It cannot be downloaded or stored.
    """
    fetched = install_studio(folder, _say)
    print(f"Studio {STUDIO_VERSION} {'is now' if fetched else 'was already'} in {folder}")


def offer_studio(program: str, folder: Path) -> None:
    """If the Studio is missing, ask the user once whether to download it, or print how to do so.

    The caller starts the viewer in any case; a failed download is only reported.
    """
    if studio_installed(folder):
        return
    declined = folder.parent / _DECLINED
    if person_reads() and not declined.exists():
        question = (
            "Look shows messages in Foxglove Studio, which is not here yet. Fetch it (37 MB)?"
        )
        if says_yes(question):
            try:
                install(folder)
            except DownloadFailed as exc:
                print(error_line(program, str(exc)), file=sys.stderr)
            return
        with suppress(OSError):  # if the answer cannot be stored, the next start asks again
            declined.parent.mkdir(parents=True, exist_ok=True)
            declined.touch()
    print(f"Look needs the Studio, all else works without it: {COMMAND}", file=sys.stderr)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
