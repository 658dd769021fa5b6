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
    'nav_to nav_to[argument <> argument@-1] nav_to[argument = argument@-2]{2,} !(pick[ok] | place[ok])* $'
  ),
  sequence_find(
    steps,
    'nav_to nav_to[argument <> argument@-1] nav_to[argument <> argument@-1 and argument <> argument@-2] nav_to[argument = argument@-3]{3,} !(pick[ok] | place[ok])* $'
  )
) AS found
FROM episodes
