-- Why episodes and calls fail.

-- A call goes on a swing where it, as a nav_to, goes back to where the call before last went; a run of such calls is a
-- swing, together with the two calls before it.
CREATE TABLE answer.oscillations AS
WITH moves AS (
  SELECT *, call.step AS step, CASE WHEN call.tool = 'nav_to' THEN call.argument END AS goes_to FROM calls
),
swinging AS (
  SELECT *, lag(goes_to) OVER steps AS before, lag(step, 2) OVER steps AS first_step
  FROM moves WINDOW steps AS (PARTITION BY episode_id ORDER BY step)
  QUALIFY lag(goes_to, 2) OVER steps = goes_to AND before <> goes_to
),
runs AS (
  SELECT *, step - row_number() OVER (PARTITION BY episode_id ORDER BY step) AS run FROM swinging
),
swings AS (
  SELECT
    count(*) + 2 AS length, min(first_step) AS first_step, least(any_value(before), any_value(goes_to)) AS one,
    greatest(any_value(before), any_value(goes_to)) AS other, episode_id
  FROM runs GROUP BY episode_id, run
)
SELECT s.length, first_step, one, other, policy, family, task_id, success, episode_id, trace
FROM swings s JOIN episodes USING (episode_id)
QUALIFY row_number() OVER (PARTITION BY episode_id ORDER BY s.length DESC, first_step) = 1
ORDER BY s.length DESC, policy, task_id, episode_id;

-- What table `classes` says of each failed episode, if it speaks of the same trace.
CREATE TABLE judged AS
WITH opinions AS (SELECT episode_id || trace_digest AS what, list(classes)[1] AS said FROM classes GROUP BY what)
SELECT
  e.*, said.sub_class AS sub_class, said.rule AS rule, said.step AS step, said.last_step AS last_step, said.evidence AS evidence,
  ifnull(said.class, 'not classified') AS name, e.steps[said.step + 1].tool AS call
FROM told e LEFT JOIN opinions ON what = e.episode_id || e.trace_digest
WHERE CASE e.success WHEN true THEN false WHEN false THEN true ELSE said IS NOT NULL END;

CREATE TABLE answer.failed_episodes AS
SELECT
  name AS class, sub_class, rule, step, last_step, call, evidence, completion, length, end_reason, policy, family,
  task_id, episode_id, trace
FROM judged ORDER BY name, sub_class, policy, task_id, episode_id;

CREATE TABLE answer.failures AS
SELECT
  policy, name AS class, sub_class, count(*) AS episodes,
  count(*) / (SELECT count(*) FROM judged every WHERE every.policy = judged.policy) AS share, min(trace) AS example
FROM judged GROUP BY policy, name, sub_class ORDER BY policy, episodes DESC, name, sub_class;

CREATE TABLE answer.errors AS
WITH totals AS (SELECT policy, call.tool AS tool, count(*) AS total FROM calls GROUP BY ALL)
SELECT
  policy, tool, call.error_code AS error, call.error_class AS class, count(*) AS calls, count(*) / any_value(total) AS share
FROM calls JOIN totals USING (policy) WHERE call.tool = tool AND error IS NOT NULL
GROUP BY ALL ORDER BY calls DESC, policy, tool, error;

CREATE TABLE answer.error_classes AS
SELECT
  policy, tool, count(*) AS calls,
  count(*) / (SELECT count(*) FROM told WHERE told.policy = calls.policy) AS calls_per_episode,
  tally(call.error_code IS NULL) AS succeeded, tally(call.error_class = 'moderate') AS moderate,
  tally(call.error_class = 'severe') AS severe, share(call.error_code IS NOT NULL) AS failed
FROM calls, unnest([call.tool, 'all']) AS names(tool) GROUP BY policy, tool ORDER BY policy, tool = 'all', tool;

CREATE TABLE answer.object_confusions AS
WITH things AS (SELECT task_digest, unnest(objects) AS thing FROM tasks)
SELECT
  policy, target_category AS wanted, target_caption AS wanted_caption, thing.category AS picked, thing.caption AS picked_caption,
  picked = wanted AS alike, count(*) AS picks, count(DISTINCT episode_id) AS episodes,
  count(DISTINCT if(success, episode_id, NULL)) AS successes, min(trace) AS example
FROM calls LEFT JOIN things ON things.task_digest = calls.task_digest AND thing.instance = call.object
WHERE letter(call) = 'q' GROUP BY ALL ORDER BY picks DESC, policy, wanted, wanted_caption, picked, picked_caption;

CREATE TABLE answer.receptacle_confusions AS
SELECT
  policy, scene_id, dest AS wanted, call.receptacle AS placed_on, list_contains(dest_distractors, placed_on) AS alike,
  placed_on = src AS source, count(*) AS places, count(DISTINCT episode_id) AS episodes,
  count(DISTINCT if(success, episode_id, NULL)) AS successes, min(trace) AS example
FROM calls JOIN (SELECT task_digest, dest_distractors FROM tasks) USING (task_digest)
WHERE letter(call) = 'l' AND call.goal_object AND NOT call.goal_receptacle
GROUP BY ALL ORDER BY places DESC, policy, scene_id, wanted, placed_on, alike, source;

-- A store in sentences. An object is left elsewhere where the last place of one that the goal does not move comes after the last
-- that puts one back.
CREATE TABLE answer.summary AS
WITH seen AS (
  SELECT e.*, said.class AS class, said.sub_class AS kind, said.cause AS cause, len(said.conflicts) > 0 AS doubt
  FROM told e LEFT JOIN (SELECT episode_id || trace_digest AS what, list(classes)[1] AS said FROM classes GROUP BY what)
    ON what = e.episode_id || e.trace_digest
),
facts AS (
  SELECT
    seen.*, measured.step AS decisive, measured.repairable_at_end AS saved,
    list_max([c.step FOR c IN seen.steps IF letter(c) = 'm' AND c.put_back IS NOT TRUE]) AS moved,
    list_max([c.step FOR c IN seen.steps IF c.tool = 'place' AND c.put_back]) AS returned
  FROM seen LEFT JOIN blame measured
    ON measured.episode_id = seen.episode_id AND measured.trace_digest = seen.trace_digest
),
topics AS (
  SELECT 1 AS part, 'episodes succeeded' AS what, success AS holds, success IS NOT NULL AS among, trace, length, episode_id FROM facts
  UNION ALL
  SELECT
    2, 'successes left an object elsewhere that the goal does not move', moved > ifnull(returned, -1), success, trace, length,
    episode_id
  FROM facts
  UNION ALL
  SELECT 4, 'measured failures could still have been saved by a competent agent at the last call', saved, NOT success AND decisive IS NOT NULL, trace, length, episode_id FROM facts
  UNION ALL
  SELECT 5, 'explanations are in doubt: rules and measurement disagree', doubt, NOT success AND class IS NOT NULL, trace, length, episode_id FROM facts
  UNION ALL
  SELECT 6, 'failures have no class yet: run reel taxonomy', class IS NULL, NOT success, trace, length, episode_id FROM facts
  UNION ALL
  SELECT
    3, 'classified failures are ' || replace(kind, '_', ' ') || ' (' || class || ifnull('; cause: ' || same_cause, '') || ')', same, NOT success AND classed, trace,
    length, episode_id
  FROM (
    SELECT k.kind, k.class, k.same_cause, facts.class IS NOT NULL AS classed, facts.success, facts.trace, facts.length, facts.episode_id,
      ifnull(facts.kind = k.kind AND facts.class = k.class, false) AS same
    FROM facts, (
      SELECT class, kind, if(len(list(DISTINCT cause) FILTER (cause IS NOT NULL)) = 1, any_value(cause), NULL) AS same_cause FROM facts WHERE NOT success AND class IS NOT NULL
      GROUP BY class, kind ORDER BY count(*) DESC, class, kind LIMIT 4
    ) k
  )
),
counted AS (
  SELECT
    part, what, tally(among AND ifnull(holds, false)) AS episodes, tally(among) AS whole,
    list(trace ORDER BY length, episode_id) FILTER (among AND ifnull(holds, false))[1:3] AS traces
  FROM topics GROUP BY part, what
)
SELECT
  row_number() OVER (ORDER BY part, episodes DESC, what) AS number,
  format('{} of {} {}, {}% [{}, {}].', episodes, whole, what, round(100 * episodes / whole)::INT, round(100 * low(episodes, whole))::INT,
    round(100 * high(episodes, whole))::INT) AS sentence,
  episodes, whole AS "of", ifnull(traces, []) AS traces
FROM counted WHERE whole > 0 AND (part = 1 OR episodes > 0) ORDER BY number;
