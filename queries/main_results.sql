-- main_results
--
-- The paper's main table: successful / total episodes, one row a policy, one column a family; the best policy first.
--
-- Columns:
--   policy   who decided
--   fdp, fodp, fdo, sul   successful / total in this family
--   all      successful / total over the four
--   success  the same as a share
--
-- Example: reel query --store store --named main_results --format csv
WITH counts AS (
  SELECT policy, family, count(*) AS total, sum(CASE WHEN success THEN 1 ELSE 0 END) AS won
  FROM episodes
  WHERE end_reason IS NOT NULL
  GROUP BY policy, family
)
SELECT
  policy,
  coalesce(max(CASE WHEN family = 'FDP' THEN concat(won, '/', total) END), '-') AS fdp,
  coalesce(max(CASE WHEN family = 'FODP' THEN concat(won, '/', total) END), '-') AS fodp,
  coalesce(max(CASE WHEN family = 'FDO' THEN concat(won, '/', total) END), '-') AS fdo,
  coalesce(max(CASE WHEN family = 'SUL' THEN concat(won, '/', total) END), '-') AS sul,
  concat(sum(won), '/', sum(total)) AS "all",
  1.0 * sum(won) / sum(total) AS success
FROM counts
GROUP BY policy
ORDER BY success DESC, policy
