"""`lidarcodec train`: train networks on one's own drives (extra `learned`)."""

from __future__ import annotations

import typer

from lidarcodec.commands import train_poconet, train_riddle

app = typer.Typer(
    help="Train networks on your own drives (extra `learned`).", no_args_is_help=True, rich_markup_mode=None
)


app.command()(train_riddle.riddle)
app.command()(train_poconet.poconet)
app.command()(train_poconet.scores)
