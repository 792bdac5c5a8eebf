"""Regressors of tables, alone or on what physics leaves."""
