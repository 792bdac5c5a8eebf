"""Networks: features, training, export."""
