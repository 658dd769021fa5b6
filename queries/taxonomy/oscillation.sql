-- oscillation
--
-- Back and forth between the same two receptacles, or round three, at least four times with nothing in between, and
-- nothing done after it (paper, Lost Action Memory). The decisive step is the first of these calls.
--
-- Class: Lost Memory
-- Sub-class: oscillation
-- Priority: 21
SELECT coalesce(
  sequence_find(
    steps,
    'nav_to nav_to[argument <> argument@-1] nav_to[argument = argument@-2]{2,} !_[ok and tool in (''pick'', ''place'', ''gaze_at'', ''show_object_by_category'', ''ask'', ''open'')]* $'
  ),
  sequence_find(
    steps,
    'nav_to nav_to[argument <> argument@-1] nav_to[argument <> argument@-1 and argument <> argument@-2] nav_to[argument = argument@-3]{3,} !_[ok and tool in (''pick'', ''place'', ''gaze_at'', ''show_object_by_category'', ''ask'', ''open'')]* $'
  )
) AS found
FROM episodes
