-- benchmark
--
-- How well each policy does in each task family, and over all of them: the metrics of the paper's evaluation.
-- Episodes whose trace breaks off are left out.
--
-- Columns:
--   policy      who decided
--   family      FDP, FODP, FDO, SUL; `all`: the four together
--   episodes    how many were played
--   success     SR: share of the episodes in which no goal change is left
--   completion  CR: mean share of the goal changes that hold
--   reward      mean cumulative reward, undiscounted
--   length      mean number of decisions
--   asks        mean number of questions to the user
--   spl         success weighted by path length, over the episodes that have a shortest path
--
-- Example: reel query --store store --named benchmark
SELECT
  policy,
  coalesce(family, 'all') AS family,
  count(*) AS episodes,
  avg(CAST(success AS DOUBLE)) AS success,
  avg(completion) AS completion,
  avg(total_reward) AS reward,
  avg(length) AS length,
  avg(asks) AS asks,
  avg(spl) AS spl
FROM episodes
WHERE end_reason IS NOT NULL AND parent_trace IS NULL
GROUP BY GROUPING SETS ((policy, family), (policy))
ORDER BY policy, CASE family WHEN 'FDP' THEN 1 WHEN 'FODP' THEN 2 WHEN 'FDO' THEN 3 WHEN 'SUL' THEN 4 WHEN 'other' THEN 5 ELSE 6 END
