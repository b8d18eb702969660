"""Published numbers (`published`) and claims (`claims`), to put measured ones next to them."""
