"""Protocols: how data are divided into training and test."""
