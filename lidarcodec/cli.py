"""The command line. Options of the commands are in `commands/signatures`, their work in the rest of `commands`.

Nothing heavy is imported here, so that `lidarcodec --help` answers at once. Exit codes: 0 done, 1 failed at work, 2
wrong usage, 130 or 143 interrupted by SIGINT or SIGTERM (live commands end with 0 then). An error is one line on
stderr; a traceback only with `--debug`.
"""

from __future__ import annotations

from typing import Annotated, NoReturn

import typer
from typer import Option

from lidarcodec.commands import bridge, token
from lidarcodec.commands.archive import command as archive
from lidarcodec.commands.convert.command import convert
from lidarcodec.commands.cut.command import cut
from lidarcodec.commands.evaluate import command as evaluate
from lidarcodec.commands.join.command import join
from lidarcodec.commands.localise.command import localise
from lidarcodec.commands.map import command as maps
from lidarcodec.commands.pipe.command import pipe
from lidarcodec.commands.running import run as running
from lidarcodec.commands.running.ending import WRONG_USAGE
from lidarcodec.commands.signatures import files, fleet, live, past
from lidarcodec.commands.train import command as train

app = typer.Typer(
    help="Compress packets of a LiDAR (Velodyne, Hesai, Ouster), send or store them, and get the same packets back.",
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="A SOURCE is a path (.pcap .pcapng .mcap .pcap.zst .pcap.xz, a KITTI folder, a rosbag), "
    "udp://HOST:PORT, or sim:city|road|street|bend|motorway|garage[?seed=1&frames=100]. Every option can also be "
    "set by an environment variable.",
)


app.add_typer(token.app, name="token")
app.add_typer(evaluate.app, name="evaluate")
app.add_typer(maps.app, name="map")
app.add_typer(train.app, name="train")
app.add_typer(bridge.app, name="bridge")
app.add_typer(archive.app, name="archive")


@app.callback()
def _common(
    context: typer.Context,
    debug: Annotated[bool, Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[bool, Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    del debug  # main() reads it from the arguments, as it may stand after the command too
    if version:
        from lidarcodec import __version__

        print(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(WRONG_USAGE)


for command in (
    files.info, files.doctor, files.encode, files.decode, convert, pipe, cut, join, files.verify, files.annotate,
    files.bench, files.simulate,
    live.publish, live.subscribe, localise, past.fetch, fleet.swarm, fleet.certs, fleet.serve, fleet.health, live.demo,
):  # fmt: skip
    app.command()(command)


def run(arguments: list[str]) -> int:
    """Run one command. Returns its exit code."""
    return running.run(app, arguments)


def main() -> NoReturn:
    """Run the command of this process's arguments, then exit with its code."""
    running.main(app)


if __name__ == "__main__":
    main()
