"""Results as documents, figures, JSON and models for other programs."""

import lazy_loader  # type: ignore[import-untyped]

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, ["figures"])  # as `jointid.figures`, which is public
