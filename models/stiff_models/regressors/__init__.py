"""Regressors of tables, on deflections or on the residuals of physics."""
