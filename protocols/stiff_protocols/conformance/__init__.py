"""What a model, a data set and a protocol must do."""
