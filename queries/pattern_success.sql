-- pattern_success
--
-- Whether doing something goes with success: SR of the episodes whose steps contain a pattern, and of the others. Both
-- differ in tasks as well: what goes together need not be cause and effect.
--
-- Columns:
--   policy    who decided
--   family    FDP, FODP, FDO, SUL
--   episodes  how many were played to an end
--   matching  of them with the pattern
--   success_with, success_without  SR of those, and of the others
--
-- Parameters:
--   $pattern = show_object_by_category[ok] gaze_at[ok] pick[ok]  the pattern
--
-- Example: reel query --store store --named pattern_success --param "pattern=ask .. pick"
WITH found AS (
  SELECT policy, family, success, sequence_match(steps, $pattern) AS matches
  FROM episodes
  WHERE success IS NOT NULL AND parent_trace IS NULL
)
SELECT
  policy, family,
  count(*) AS episodes,
  count(*) FILTER (WHERE matches) AS matching,
  avg(CAST(success AS DOUBLE)) FILTER (WHERE matches) AS success_with,
  avg(CAST(success AS DOUBLE)) FILTER (WHERE NOT matches) AS success_without
FROM found
GROUP BY policy, family
ORDER BY policy, family
