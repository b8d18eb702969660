from .compact import (
    positions as positions,
    representatives as representatives,
    sample as sample,
    sample_rows as sample_rows,
)
from .self_organizing import som as som
from .spectral_clustering import affinity as affinity, spectral as spectral
