-- graph_events
--
-- What tools do to the world graphs, in physics and in the registry: an object that falls, or that settles elsewhere,
-- shows as a change that its tool does not make.
--
-- Columns:
--   tool        what was called; `(start)`: settling before the first decision
--   succeeded   whether the call did without an error
--   event       add, remove, door
--   floor       whether it concerns the floor
--   physics     changes of the graph that physics keeps
--   registry    changes of the graph that pick and place keep
--   bystanders  changes of either graph to an object that the call did not act on
--   episodes    in how many episodes
--   example     one of them: a trace to look at
--
-- Example: reel query --store store "SELECT * FROM graph_events WHERE bystanders > 0"
WITH changes AS (
  SELECT
    w.episode_id, s.tool, s.error_code IS NULL AS succeeded, w.authority, w.event, w.receptacle,
    w.object IS NOT NULL AND w.object IS DISTINCT FROM s.object AS bystander
  FROM world_diffs w
  JOIN steps s ON s.episode_id = w.episode_id AND s.step = w.step
  UNION ALL
  SELECT episode_id, '(start)', true, c['authority'], c['event'], c['receptacle'], c['object'] IS NOT NULL
  FROM (SELECT episode_id, unnest(start_changes) AS c FROM episodes)
)
SELECT
  c.tool, c.succeeded, c.event,
  c.receptacle = 'floor' AS floor,
  count(*) FILTER (WHERE c.authority = 'physics') AS physics,
  count(*) FILTER (WHERE c.authority = 'registry') AS registry,
  count(*) FILTER (WHERE c.bystander) AS bystanders,
  count(DISTINCT c.episode_id) AS episodes,
  min(e.trace) AS example
FROM changes c
JOIN episodes e ON e.episode_id = c.episode_id
WHERE e.parent_trace IS NULL
GROUP BY c.tool, c.succeeded, c.event, floor
ORDER BY c.tool, c.succeeded, c.event, floor
