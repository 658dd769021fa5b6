-- oscillations
--
-- Runs of `nav_to` calls that go back and forth between two receptacles with nothing in between (A-B-A-B ...), the longest
-- first. Four calls or more are the mark of Lost Memory.
--
-- Columns:
--   length      nav_to calls in the run (at least 3: A-B-A)
--   first_step  decision with which it begins
--   one, other  the two receptacles
--   policy, family, task_id, success, episode_id, trace  the episode
--
-- Example: reel query --store store "SELECT policy, max(length) AS longest FROM oscillations GROUP BY policy"
WITH calls AS (
  SELECT
    episode_id, step, tool, argument,
    lag(tool, 1) OVER w AS tool_1, lag(argument, 1) OVER w AS argument_1,
    lag(tool, 2) OVER w AS tool_2, lag(argument, 2) OVER w AS argument_2
  FROM steps
  WINDOW w AS (PARTITION BY episode_id ORDER BY step)
),
-- calls that turn back to where the robot was two calls ago; neighbours of one run share `run`
turns AS (
  SELECT
    episode_id, step, argument, argument_1,
    CAST(step AS BIGINT) - CAST(row_number() OVER (PARTITION BY episode_id ORDER BY step) AS BIGINT) AS run
  FROM calls
  WHERE tool = 'nav_to' AND tool_1 = 'nav_to' AND tool_2 = 'nav_to' AND argument = argument_2 AND argument <> argument_1
),
runs AS (
  SELECT
    episode_id, run, count(*) + 2 AS length, min(step) - 2 AS first_step,
    least(min(argument), min(argument_1)) AS one, greatest(max(argument), max(argument_1)) AS other
  FROM turns
  GROUP BY episode_id, run
)
SELECT
  r.length, r.first_step, r.one, r.other,
  e.policy, e.family, e.task_id, e.success, e.episode_id, e.trace
FROM runs r
JOIN episodes e ON e.episode_id = r.episode_id
ORDER BY r.length DESC, e.policy, e.task_id, r.episode_id, r.first_step
