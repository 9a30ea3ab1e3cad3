"""What a URL of PostgreSQL says holds, and databases of every encoding can be used."""

from __future__ import annotations

import pytest
import sqlalchemy as sa

from lidarcodec_server.store.store import Store
from lidarcodec_server.tokens import TokenBook, create_token
from tests.server.test_store import postgres

__all__ = ["postgres"]


def run(url: str, *statements: str) -> None:
    """Run statements that must be outside of a transaction."""
    engine = sa.create_engine(url.replace("postgresql:", "postgresql+psycopg:"), isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        for statement in statements:
            connection.exec_driver_sql(statement)
    engine.dispose()


def token_of(url: str) -> tuple[TokenBook, str]:
    """Open a database, make a token in it, and read the tokens as a server does."""
    store = Store(url)
    store.open()
    return TokenBook(store), create_token(store, "ada", "operator")


def test_two_servers_with_a_schema_each_do_not_share_tokens(postgres):
    """`?options=-csearch_path=...` was left out: both used `public`, and a token of one opened the other."""
    run(postgres, "CREATE SCHEMA works", "CREATE SCHEMA trial")
    urls = [f"{postgres}?options=-csearch_path%3D{name}" for name in ("works", "trial")]
    (works, token), (trial, other) = (token_of(url) for url in urls)
    assert works.client(token) is not None
    assert trial.client(other) is not None
    assert trial.client(token) is None
    engine = sa.create_engine(postgres.replace("postgresql:", "postgresql+psycopg:"))
    assert sa.inspect(engine).has_table("tokens", schema="works")
    assert not sa.inspect(engine).has_table("tokens", schema="public")
    engine.dispose()


def test_what_the_url_says_takes_no_time_limit_away(postgres):
    """A statement ends after five seconds, whatever the URL asks for."""
    store = Store(f"{postgres}?options=-cstatement_timeout%3D0&options=-cwork_mem%3D1MB")
    with store._engine.connect() as connection:
        assert connection.exec_driver_sql("SHOW statement_timeout").scalar_one() == "5s"
        assert connection.exec_driver_sql("SHOW work_mem").scalar_one() == "1MB"
    store.close()


@pytest.mark.parametrize("encoding", ["SQL_ASCII", "LATIN1"])
def test_a_database_of_another_encoding_can_be_used(postgres, encoding):
    """SQL_ASCII is what `initdb` makes where no language is set: `unexpected TypeError` was all that was said."""
    run(postgres, f"CREATE DATABASE {encoding.lower()} ENCODING '{encoding}' TEMPLATE template0")
    book, token = token_of(postgres.replace("/postgres", f"/{encoding.lower()}"))
    assert book.client(token).name == "ada"
