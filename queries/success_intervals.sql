-- success_intervals
--
-- Success rates with their uncertainty: Wilson's 95 % interval, by policy and family, and over all families.
-- The interval takes episodes as independent; where tasks are played several times it is too narrow.
--
-- Columns:
--   policy     who decided
--   family     FDP, FODP, FDO, SUL; `all`: the four together
--   episodes   how many were played to an end
--   tasks      different ones among them
--   successes  successful ones
--   success    SR
--   low, high  the interval
--
-- Example: reel query --store store --named success_intervals
SELECT
  policy,
  coalesce(family, 'all') AS family,
  count(*) AS episodes,
  count(DISTINCT task_digest) AS tasks,
  count(*) FILTER (WHERE success) AS successes,
  avg(CAST(success AS DOUBLE)) AS success,
  wilson_low(count(*) FILTER (WHERE success), count(*)) AS low,
  wilson_high(count(*) FILTER (WHERE success), count(*)) AS high
FROM episodes
WHERE success IS NOT NULL AND parent_trace IS NULL
GROUP BY GROUPING SETS ((policy, family), (policy))
ORDER BY policy, CASE family WHEN 'FDP' THEN 1 WHEN 'FODP' THEN 2 WHEN 'FDO' THEN 3 WHEN 'SUL' THEN 4 WHEN 'other' THEN 5 ELSE 6 END
