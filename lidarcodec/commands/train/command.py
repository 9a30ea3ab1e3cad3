"""`lidarcodec train`: trains networks on the user's own drives (extra `learned`)."""

from __future__ import annotations

import typer

from lidarcodec.commands.train import map_points, poconet, riddle

app = typer.Typer(
    help="Train networks on your own drives (extra `learned`).", no_args_is_help=True, rich_markup_mode=None
)


app.command()(riddle.riddle)
app.command()(poconet.poconet)
app.command()(poconet.scores)
app.command()(map_points.map_points)
