"""Controllers: signals in, signals out, no power."""

from phfmu.listed_names import list_names

list_names(__name__)
