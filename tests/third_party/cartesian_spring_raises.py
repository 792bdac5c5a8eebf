"""Stand for a plugin whose library is not installed."""

import not_there  # noqa: F401
