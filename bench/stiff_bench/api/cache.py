"""The cache of pre-trained networks."""

from stiff_models.networks.cache import CacheInfo, cache_info, clear_cache

__all__ = ["CacheInfo", "cache_info", "clear_cache"]
