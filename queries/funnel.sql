-- funnel
--
-- From the instruction to success: how many episodes come how far, and where they are lost.
--
-- Columns:
--   policy      who decided
--   stage       1 told, 2 went to the source, 3 saw the target, 4 picked the right object, 5 then went to the destination,
--               6 placed the object where the goal wants it, 7 success
--   reached     episodes that reached this stage, by whatever way: the last one counts the successes
--   passed      episodes that reached it and every stage before it
--   share       `passed` of all episodes
--   step_share  `passed` of those that passed the stage before
--
-- Example: reel query --store store --named funnel
WITH moves AS (
  SELECT
    s.episode_id,
    bool_or(s.tool = 'nav_to' AND s.receptacle = e.src) AS went,
    min(s.step) FILTER (WHERE s.tool = 'pick' AND s.goal_object) AS picked,
    max(s.step) FILTER (WHERE s.tool = 'nav_to' AND s.receptacle = e.dest) AS arrived,
    bool_or(s.tool = 'place' AND s.goal_object AND s.goal_receptacle) AS placed
  FROM steps s
  JOIN episodes e ON e.episode_id = s.episode_id
  WHERE s.error_code IS NULL
  GROUP BY s.episode_id
),
sights AS (
  SELECT episode_id, unnest(new_objects) AS object FROM steps
  UNION ALL
  SELECT episode_id, object FROM visible_objects WHERE step = -1
),
saw AS (
  SELECT DISTINCT s.episode_id FROM sights s JOIN episodes e ON e.episode_id = s.episode_id AND e.target = s.object
),
stages AS (
  SELECT
    e.policy, e.episode_id,
    unnest([
      'told', 'went to the source', 'saw the target', 'picked the right object', 'went to the destination',
      'placed the object right', 'success'
    ]) AS stage,
    unnest([1, 2, 3, 4, 5, 6, 7]) AS number,
    unnest([
      true,
      coalesce(m.went, false),
      v.episode_id IS NOT NULL,
      m.picked IS NOT NULL,
      coalesce(m.arrived > m.picked, false),
      coalesce(m.placed, false),
      e.success
    ]) AS reached
  FROM episodes e
  LEFT JOIN moves m ON m.episode_id = e.episode_id
  LEFT JOIN saw v ON v.episode_id = e.episode_id
  WHERE e.success IS NOT NULL AND e.target <> '' AND e.parent_trace IS NULL
),
passes AS (
  SELECT *, min(CAST(reached AS INT)) OVER (PARTITION BY episode_id ORDER BY number) AS passed FROM stages
),
counts AS (
  SELECT policy, number, stage, sum(CAST(reached AS INT)) AS reached, sum(passed) AS passed, count(*) AS episodes
  FROM passes
  GROUP BY policy, number, stage
)
SELECT
  policy, concat(number, ' ', stage) AS stage, reached, passed,
  1.0 * passed / episodes AS share,
  1.0 * passed / nullif(lag(passed) OVER (PARTITION BY policy ORDER BY number), 0) AS step_share
FROM counts
ORDER BY policy, number
