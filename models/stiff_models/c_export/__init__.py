"""Fitted models as C99 source."""
