"""Property tests try the same examples everywhere; ``HYPOTHESIS_PROFILE=default python -m pytest`` explores others."""

import os

from hypothesis import settings

settings.register_profile("steady", derandomize=True, deadline=None, database=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "steady"))
