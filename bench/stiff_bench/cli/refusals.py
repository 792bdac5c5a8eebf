"""What click refuses, in one line that names the word and what is valid."""

from __future__ import annotations

import click

from stiff_protocols.contract.errors import unknown_name


def refusal(error: click.ClickException) -> str:
    """Return a message of click's, with what is valid where click does not say it."""
    message = error.format_message().removesuffix(".")
    ctx = error.ctx if isinstance(error, click.UsageError) else None
    if ctx is None:
        return message
    if isinstance(error, click.NoSuchOption):
        options = [
            name
            for one in ctx.command.get_params(ctx)
            for name in (*one.opts, *one.secondary_opts)
            if name.startswith("--")
        ]
        text = str(unknown_name(f"{ctx.command_path} option", error.option_name, options))
        return f"{text}; {_usage(ctx)}"
    if isinstance(error, click.MissingParameter) and isinstance(error.param, click.Option):
        return f"{message}; {': '.join(error.param.get_help_record(ctx) or ())}"
    if isinstance(error, click.BadParameter) and not isinstance(error, click.MissingParameter):
        return message
    return f"{message}; {_usage(ctx)}"


def _usage(ctx: click.Context) -> str:
    return ctx.get_usage().replace("Usage", "usage", 1)
