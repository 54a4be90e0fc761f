"""Decode navigation units to fixes (`nav_decoder.NavFix`) and merge several units into one track (`merge`)."""
