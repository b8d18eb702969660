"""Reproduce published tables and figures, each with one call or one command.

result = siamloc.reproduce.reproduce("figure_3_11", data="freiburg_sim", scale="short")
print(result.table())
result.save("reproduced")
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
