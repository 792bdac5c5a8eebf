"""Check the interfaces of models, data sets and protocols."""
