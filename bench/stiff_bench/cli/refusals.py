"""Errors of click in one line, with the wrong word and the valid ones."""

from __future__ import annotations

import click

from stiff_protocols.contract.errors import unknown_name


def refusal(error: click.ClickException) -> str:
    """Return the message of an error of click with the valid words or an example."""
    message = error.format_message().removesuffix(".")
    ctx = error.ctx if isinstance(error, click.UsageError) else None
    if ctx is None:
        return message
    if isinstance(error, click.NoSuchOption):
        options = [
            name
            for option in ctx.command.get_params(ctx)
            for name in (*option.opts, *option.secondary_opts)
            if name.startswith("--")
        ]
        return str(unknown_name(f"{ctx.command_path} option", error.option_name, options))
    if isinstance(error, click.MissingParameter) and isinstance(error.param, click.Option):
        return f"{message}; {': '.join(error.param.get_help_record(ctx) or ())}"
    if isinstance(error, click.BadParameter) and not isinstance(error, click.MissingParameter):
        return message
    example, *_ = (ctx.command.epilog or "").splitlines() or [""]
    return f"{message}; {ctx.get_usage().replace('Usage', 'usage', 1)}; example: {example}"
