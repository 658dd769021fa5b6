-- main_results
--
-- The paper's main table: successful / total episodes, one row a policy, one column a family; the best policy first.
-- `success_intervals` has the uncertainty of each family.
--
-- Columns:
--   policy   who decided
--   fdp, fodp, fdo, sul  successful / total in this family
--   all      successful / total over the four
--   success  the same as a share
--   low, high  Wilson's 95 % interval of it
--
-- Example: reel query --store store --named main_results --format csv
WITH counts AS (
  SELECT policy, family, count(*) AS total, count(*) FILTER (WHERE success) AS successes
  FROM episodes
  WHERE success IS NOT NULL AND family <> 'other' AND parent_trace IS NULL
  GROUP BY policy, family
)
SELECT
  policy,
  coalesce(max(concat(successes, '/', total)) FILTER (WHERE family = 'FDP'), '-') AS fdp,
  coalesce(max(concat(successes, '/', total)) FILTER (WHERE family = 'FODP'), '-') AS fodp,
  coalesce(max(concat(successes, '/', total)) FILTER (WHERE family = 'FDO'), '-') AS fdo,
  coalesce(max(concat(successes, '/', total)) FILTER (WHERE family = 'SUL'), '-') AS sul,
  concat(sum(successes), '/', sum(total)) AS "all",
  1.0 * sum(successes) / sum(total) AS success,
  wilson_low(sum(successes), sum(total)) AS low,
  wilson_high(sum(successes), sum(total)) AS high
FROM counts
GROUP BY policy
ORDER BY success DESC, policy
