-- rollouts
--
-- The paper's analysis of rollouts during training: success, the canonical pipeline, questions, and how many failures
-- are of the eye, not of the procedure. Rollouts that begin at a recorded call are left out: their first calls are not the policy's.
--
-- Columns:
--   policy           who decided
--   episodes         how many were played to an end
--   success          SR
--   canonical        share of the episodes with nav_to, show_object_by_category, gaze_at, pick, nav_to, show_receptacles,
--                    place, each of them with success and directly after the one before
--   in_order         the same with other calls allowed in between
--   asked            share of the episodes with a question
--   asked_well       share of these in which at least one question was useful (see `questions`)
--   failed           failed episodes
--   procedure_right  share of these with a pick and a later place that both worked
--   wrong_object     share of these in which, moreover, the last such place set down an object that the goal does not move,
--                    wherever: procedure right, object wrong
--
-- Parameters:
--   $run = %  run, as in LIKE; %: any
--
-- Example: reel query --store store --named rollouts
WITH of_episode AS (
  SELECT episode_id, max(CAST(useful AS INT)) AS useful FROM questions GROUP BY episode_id
),
facts AS (
  SELECT
    policy, success, q.useful,
    sequence_match(steps, 'nav_to[ok] show_object_by_category[ok] gaze_at[ok] pick[ok] nav_to[ok] show_receptacles[ok] place[ok]')
      AS canonical,
    sequence_match(
      steps,
      'nav_to[ok] .. show_object_by_category[ok] .. gaze_at[ok] .. pick[ok] .. nav_to[ok] .. show_receptacles[ok] .. place[ok]'
    ) AS in_order,
    sequence_match(steps, 'pick[ok] .. place[ok]') AS procedure_right,
    sequence_match(steps, 'pick[ok] .. place[ok and not goal_object] !place[ok]* $') AS wrong_object
  FROM episodes e
  LEFT JOIN of_episode q ON q.episode_id = e.episode_id
  WHERE success IS NOT NULL AND parent_trace IS NULL AND run_id LIKE CAST($run AS VARCHAR)
)
SELECT
  policy,
  count(*) AS episodes,
  avg(CAST(success AS DOUBLE)) AS success,
  avg(CAST(canonical AS DOUBLE)) AS canonical,
  avg(CAST(in_order AS DOUBLE)) AS in_order,
  1.0 * count(useful) / count(*) AS asked,
  avg(useful) AS asked_well,
  count(*) FILTER (WHERE NOT success) AS failed,
  avg(CAST(procedure_right AS DOUBLE)) FILTER (WHERE NOT success) AS procedure_right,
  avg(CAST(wrong_object AS DOUBLE)) FILTER (WHERE NOT success) AS wrong_object
FROM facts
GROUP BY policy
ORDER BY policy
