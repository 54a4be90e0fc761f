"""Explain the codes that confirmation of a detection reports, and on which side of the decision each stands.

The codes of detection itself have theirs in `auv_mcm.detect.belief`.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

from auv_mcm.confirm.snake_rules import REJECTING
from auv_mcm.detect.belief import REASONS

Bearing: TypeAlias = Literal["for", "against", "note"]

CLOSE_LOOK_REASONS: Final[dict[str, str]] = {
    # what was confirmed
    "not_looked_at": "the odds of a mine were too low for confirmation",
    "over_budget": (
        "there were more detections than the limits of confirmation allow: this one keeps the odds of the step before"
    ),
    "look_failed": "confirmation at it failed: this one keeps the detector's odds",
    "views_contradict": (
        "its views contradict each other so much that they may show two objects: the most mine-like one stands for it"
    ),
    "kinds_agree": "views from other directions show the same kind of mine, which raises its odds",
    "kinds_differ": "views from other directions show another kind of mine, as a stone's do, which lowers its odds",
    "region_too_small": "too few pixels around it for confirmation",
    "geometry_unknown": "altitude or range is not known there, so that no height can be measured",
    "no_echo": "no echo at all was recorded around it",
    "not_measured": "nothing was measured where its echo and shadow should be",
    "no_data": "nothing was measured that a shape could be compared with",
    "too_little_data": "too little was measured around it to separate echo, shadow and sea floor",
    "no_speckle": "the picture has no speckle, without which echo and shadow cannot be separated from sea floor",
    # its contours
    "start_replaced": "the first outline was not a polygon: the contours started from plain boxes instead",
    "touches_border": "its echo or shadow runs along the border of the region searched",
    "too_short": "echo and shadow are shorter along the track than those of any mine",
    "too_long": "echo and shadow are longer along the track than those of any mine",
    "highlight_too_large": "its echo covers more sea floor than that of any mine",
    "shadow_too_large": "its shadow is larger than that of the largest mine there",
    "too_low": "its shadow is that of something lower than any mine",
    "too_high": "its shadow is that of something higher than any mine",
    "shadow_not_dark": "its shadow is too bright: sound still comes back from it",
    "shadow_goes_on": "the dark goes on beside it along the track, as in the trough of a ripple",
    "in_shadow": (
        "the dark begins nearer, and it has no bright echo: it lies in the shadow of something else, where nothing "
        "can be seen"
    ),
    "hole_in_bright": "it is bright on both sides of the shadow: a gap in a bright patch, such as grass",
    "little_evidence": "contours of an object explain the picture hardly better than bare sea floor",
    "repeats": "the same contours fit other places nearby as well, as on ripples or grass",
    # the solids fitted
    "clutter": "free contours explain echo and shadow far better than the shape of any mine",
    "at_bound": "a size of the best model is the last one tried: the object may be another size or shape",
    "altitude": "a shape fits only for another altitude than was measured: heights are uncertain",
    "buried": "the best model lies partly buried",
    "cut_off": "the object or its shadow is cut off by the border of the region searched",
    "not_listed": "kind and size as measured are on no line of the list of mines expected, which lowers its odds",
    "weak_highlight": "too little echo before the shadow to count: the shadow alone gives the shape",
}

_FOR: Final = frozenset({"highlight_and_shadow", "kinds_agree"})
_AGAINST: Final = REJECTING | {
    *("no_highlight", "no_shadow", "too_large", "too_small", "implausible_height", "crowded", "extended", "clutter"),
    *("not_listed", "kinds_differ"),
}


def in_words(code: str) -> str:
    """Explain a code of detection or confirmation; a code without an entry is given by its own name."""
    return REASONS.get(code) or CLOSE_LOOK_REASONS.get(code) or code.replace("_", " ")


def bearing(code: str) -> Bearing:
    """Classify a code: for a mine, against one, or only about how far the view can be trusted."""
    return "for" if code in _FOR else "against" if code in _AGAINST else "note"
