"""What is true of a server from some day on: that tokens were needed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Once there was a token, one was needed."""
    op.create_table(
        "facts",
        sa.Column("name", sa.String(32), nullable=False),
        sa.Column("at_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("name", name="pk_facts"),
    )
    op.execute(
        "INSERT INTO facts (name, at_ns) SELECT 'tokens-needed', MIN(created_ns) FROM tokens HAVING COUNT(*) > 0"
    )


def downgrade() -> None:
    """Without them."""
    op.drop_table("facts")
