"""with_password: a database URL with a password from a separate file.

Docker and systemd provide secrets as files. An environment variable is less safe: other programs can often read it.
"""

from __future__ import annotations

from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import ArgumentError

from lidarcodec.budgets import FileTooLargeError, read_file
from lidarcodec.errors import SettingsError


def with_password(url: str | None, file: Path) -> str:
    """The URL with the first line of the file as its password.

    Raises SettingsError if the file is missing or too long, or if there is no URL or it already has a password.
    """
    try:
        password = read_file(file, "secret").decode().partition("\n")[0].rstrip("\r")
    except OSError as error:
        raise SettingsError(f"{file}: {error.strerror}", "database_password_file") from None
    except FileTooLargeError as error:
        raise SettingsError(f"{file}: {error}", "database_password_file") from None
    except UnicodeDecodeError:
        password = ""
    if not password:
        raise SettingsError(f"the first line of {file} must be the password", "database_password_file")
    try:
        parsed = sa.make_url(url or "")
    except ArgumentError:
        parsed = None
    if parsed is None or not parsed.username or parsed.password is not None:
        raise SettingsError(
            "--database-password-file needs a database URL with a user and without a password, such as "
            "postgresql://lidarcodec@database/lidarcodec",
            "database_url",
        )
    return parsed.set(password=password).render_as_string(hide_password=False)
