"""Fitted models as files, and models that are being written."""
