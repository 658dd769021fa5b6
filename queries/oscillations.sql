-- oscillations
--
-- The longest run of `nav_to` calls of each episode that goes back and forth between two receptacles with nothing in
-- between (A-B-A-B ...), the longest first. Four calls or more are the mark of Lost Memory.
--
-- Columns:
--   length      nav_to calls in the run (at least 3: A-B-A)
--   first_step  decision with which it begins
--   one, other  the two receptacles
--   policy, family, task_id, success, episode_id, trace  the episode
--
-- Example: reel query --store store "SELECT policy, max(length) AS longest FROM oscillations GROUP BY policy"
WITH runs AS (
  SELECT oscillation(steps) AS run, policy, family, task_id, success, episode_id, trace
  FROM episodes
  WHERE parent_trace IS NULL
)
SELECT
  run['length'] AS length, run['first'] AS first_step, run['one'] AS one, run['other'] AS other,
  policy, family, task_id, success, episode_id, trace
FROM runs
WHERE run IS NOT NULL
ORDER BY length DESC, policy, task_id, episode_id
