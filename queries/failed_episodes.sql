-- failed_episodes
--
-- Every failed episode with its class (paper, Failure Analysis) and the evidence: a first look by ten rules. `reel taxonomy`
-- has the full set, and keeps its result in table `classes`. The first rule that holds decides:
--   1. Key Action Missing, no question: a fuzzy instruction, no `ask`, and the wrong thing picked or the wrong place
--      used; outranks Object Confusion although the wrong object was picked
--   2. Object Confusion, wrong object: the last pick took an object that the goal does not move
--   3. Object Confusion, similar furniture: the goal object was last placed where it does not belong
--   4. Key Action Missing, closed door: a call failed at a closed door and no door was opened
--   5. Lost Memory, oscillation: four or more nav_to calls A-B-A-B with nothing in between
--   6. Key Action Missing, closed door: a door that had to be opened never was
--   7. Key Action Missing, no question: as 1, with several candidates seen and nothing picked
--   8. Key Action Missing, never placed / never picked: `finish` was called without it
--   9. Lost Memory, no progress: the horizon was reached
--  10. Other
--
-- Columns:
--   class, cause    the result
--   evidence        the numbers and names it rests on
--   done, length, end_reason  how far the episode came
--   policy, family, task_id, episode_id, trace  the episode
--
-- Example: reel query --store store "SELECT * FROM failed_episodes WHERE class = 'Other'"
WITH facts AS (
  SELECT
    episode_id,
    first_value(object ORDER BY step DESC) FILTER (WHERE tool = 'pick' AND error_code IS NULL) AS picked,
    first_value(step ORDER BY step DESC) FILTER (WHERE tool = 'pick' AND error_code IS NULL) AS pick_step,
    first_value(goal_object ORDER BY step DESC) FILTER (WHERE tool = 'pick' AND error_code IS NULL) AS pick_right,
    first_value(receptacle ORDER BY step DESC) FILTER (WHERE tool = 'place' AND error_code IS NULL AND goal_object) AS placed_on,
    first_value(step ORDER BY step DESC) FILTER (WHERE tool = 'place' AND error_code IS NULL AND goal_object) AS place_step,
    first_value(goal_receptacle ORDER BY step DESC) FILTER (WHERE tool = 'place' AND error_code IS NULL AND goal_object) AS place_right,
    min(step) FILTER (WHERE error_code = 'door_closed') AS door_step,
    count(*) FILTER (WHERE tool = 'open' AND error_code IS NULL) AS opened,
    count(*) FILTER (WHERE tool = 'place' AND error_code IS NULL) AS places,
    max(candidates) AS candidates
  FROM steps
  GROUP BY episode_id
),
doors AS (
  SELECT DISTINCT episode_id, receptacle FROM steps WHERE tool = 'open' AND error_code IS NULL
),
swings AS (
  SELECT
    episode_id,
    max(length) AS swing,
    first_value(concat(one, ' and ', other, ' from step ', first_step) ORDER BY length DESC, first_step) AS where_to
  FROM oscillations
  GROUP BY episode_id
),
judged AS (
  SELECT
    e.episode_id, e.policy, e.family, e.task_id, e.completion, e.length, e.end_reason, e.src, e.dest, e.target, e.trace,
    f.picked, f.pick_step, f.placed_on, f.place_step, f.door_step, f.candidates, s.swing, s.where_to,
    e.fuzzy AND e.asks = 0 AS unasked,
    coalesce(NOT f.pick_right, false) AS wrong_object,
    coalesce(f.pick_right AND NOT f.place_right, false) AS wrong_place,
    f.door_step IS NOT NULL AND f.opened = 0 AS stuck_at_door,
    coalesce(s.swing, 0) >= 4 AS oscillates,
    (t.src_door = 'closed' AND a.receptacle IS NULL)
      OR (t.dest_door = 'closed' AND coalesce(f.pick_right, false) AND b.receptacle IS NULL) AS door_left,
    f.pick_step IS NULL AS no_pick,
    coalesce(f.places, 0) = 0 AS no_place
  FROM episodes e
  JOIN tasks t ON t.task_digest = e.task_digest
  LEFT JOIN facts f ON f.episode_id = e.episode_id
  LEFT JOIN swings s ON s.episode_id = e.episode_id
  LEFT JOIN doors a ON a.episode_id = e.episode_id AND a.receptacle = e.src
  LEFT JOIN doors b ON b.episode_id = e.episode_id AND b.receptacle = e.dest
  WHERE NOT e.success
),
ruled AS (
  SELECT
    *,
    CASE
      WHEN unasked AND (wrong_object OR wrong_place) THEN 1
      WHEN wrong_object THEN 2
      WHEN wrong_place THEN 3
      WHEN stuck_at_door THEN 4
      WHEN oscillates THEN 5
      WHEN door_left THEN 6
      WHEN unasked AND no_pick AND candidates > 1 THEN 7
      WHEN end_reason = 'finished' AND (no_pick OR no_place) THEN 8
      WHEN end_reason = 'horizon' THEN 9
      ELSE 10
    END AS rule
  FROM judged
)
SELECT
  CASE
    WHEN rule IN (1, 4, 6, 7, 8) THEN 'Key Action Missing'
    WHEN rule IN (2, 3) THEN 'Object Confusion'
    WHEN rule IN (5, 9) THEN 'Lost Memory'
    ELSE 'Other'
  END AS class,
  CASE rule
    WHEN 1 THEN 'no question'
    WHEN 2 THEN 'wrong object'
    WHEN 3 THEN 'similar furniture'
    WHEN 4 THEN 'closed door'
    WHEN 5 THEN 'oscillation'
    WHEN 6 THEN 'closed door'
    WHEN 7 THEN 'no question'
    WHEN 8 THEN CASE WHEN no_pick THEN 'never picked' ELSE 'never placed' END
    WHEN 9 THEN 'no progress'
    ELSE 'other'
  END AS cause,
  CASE
    WHEN rule = 1 AND wrong_object THEN concat('no ask, ', candidates, ' candidates seen; step ', pick_step, ' picked ', picked)
    WHEN rule = 1 THEN concat('no ask; step ', place_step, ' placed on ', placed_on, ', not ', dest)
    WHEN rule = 2 THEN concat('step ', pick_step, ' picked ', picked, ', not ', target)
    WHEN rule = 3 THEN concat('step ', place_step, ' placed on ', placed_on, ', not ', dest)
    WHEN rule = 4 THEN concat('step ', door_step, ' met a closed door, none was opened')
    WHEN rule = 5 THEN concat(swing, ' nav_to between ', where_to)
    WHEN rule = 6 THEN concat('door of ', src, ' or ', dest, ' never opened')
    WHEN rule = 7 THEN concat('no ask, ', candidates, ' candidates seen, none picked')
    WHEN rule = 8 THEN concat('finish after ', length, ' decisions')
    WHEN rule = 9 THEN concat(length, ' decisions')
    ELSE coalesce(concat('last pick ', picked, ', last place ', placed_on), '')
  END AS evidence,
  completion AS done, length, end_reason, policy, family, task_id, episode_id, trace
FROM ruled
ORDER BY rule, policy, task_id, episode_id
