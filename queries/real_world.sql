-- real_world
--
-- The paper's compact table of end-to-end episodes: success, steps, SPL, questions and time to think, by family and
-- over all episodes.
--
-- Columns:
--   policy     who decided
--   family     FDP, FODP, FDO, SUL; `all`: every episode
--   episodes   how many were played to an end
--   success    SR
--   steps      mean number of decisions
--   spl        success weighted by path length, over the episodes that have a shortest path
--   asks       mean number of questions to the user
--   latency_s  mean time that the policy took over an episode, seconds, over the episodes that tell of it
--
-- Parameters:
--   $backend = %  sim, robot or proxy, as in LIKE; %: any
--
-- Example: reel query --store store --named real_world --param backend=robot
WITH thought AS (
  SELECT episode_id, sum(latency_ns) / 1e9 AS latency_s FROM steps GROUP BY episode_id
)
SELECT
  e.policy,
  coalesce(e.family, 'all') AS family,
  count(*) AS episodes,
  avg(CAST(e.success AS DOUBLE)) AS success,
  avg(e.length) AS steps,
  avg(e.spl) AS spl,
  avg(e.asks) AS asks,
  avg(t.latency_s) AS latency_s
FROM episodes e
LEFT JOIN thought t ON t.episode_id = e.episode_id
WHERE e.end_reason IS NOT NULL AND e.parent_trace IS NULL AND e.backend LIKE CAST($backend AS VARCHAR)
GROUP BY GROUPING SETS ((e.policy, e.family), (e.policy))
ORDER BY policy, CASE family WHEN 'FDP' THEN 1 WHEN 'FODP' THEN 2 WHEN 'FDO' THEN 3 WHEN 'SUL' THEN 4 ELSE 5 END
