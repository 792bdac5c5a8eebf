"""What `bench` says on standard error."""

from __future__ import annotations

import click


def say(message: str) -> None:
    """Print one line for people."""
    click.echo(f"bench: {message}", err=True)
