"""The experiments of Pandita 2022, chapter 5."""
