"""Published numbers, to put measured ones next to them."""
