"""Before any test draws: Triton, which torch loads late, dies of Mesa's LLVM."""

import contextlib
import warnings

with contextlib.suppress(ImportError), warnings.catch_warnings(action="ignore"):
    import torch._dynamo  # noqa: F401
