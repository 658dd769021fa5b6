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

-- The first rule that holds, with its evidence; the header of `queries/failed_episodes.sql` has the rules.
CREATE TABLE judged AS
WITH facts AS (
  SELECT
    e.*, t.src_door, t.dest_door, swing,
    [call FOR call IN e.steps IF call.error_code IS NULL] AS done,
    [call FOR call IN done IF call.tool = 'pick'][-1] AS pick,
    [call FOR call IN done IF call.tool = 'place' AND call.goal_object][-1] AS place,
    [call.receptacle FOR call IN done IF call.tool = 'open'] AS opened,
    [call.step FOR call IN e.steps IF call.error_code = 'door_closed'][1] AS door,
    list_max([call.candidates FOR call IN e.steps]) AS candidates
  FROM told e JOIN tasks t USING (task_digest) LEFT JOIN answer.oscillations swing ON swing.episode_id = e.episode_id
  WHERE NOT e.success
),
findings AS (
  SELECT
    *, fuzzy AND asks = 0 AS unasked, NOT pick.goal_object AS wrong_object,
    pick.goal_object AND NOT place.goal_receptacle AS wrong_place
  FROM facts
),
judgements AS (
  SELECT *, [
    {'rule': 1, 'class': 'Key Action Missing', 'cause': 'no question', 'holds': unasked AND wrong_object,
     'evidence': concat('no ask, ', candidates, ' candidates seen; step ', pick.step, ' picked ', pick.object)},
    {'rule': 1, 'class': 'Key Action Missing', 'cause': 'no question', 'holds': unasked AND wrong_place,
     'evidence': concat('no ask; step ', place.step, ' placed on ', place.receptacle, ', not ', dest)},
    {'rule': 2, 'class': 'Object Confusion', 'cause': 'wrong object', 'holds': wrong_object,
     'evidence': concat('step ', pick.step, ' picked ', pick.object, ', not ', target)},
    {'rule': 3, 'class': 'Object Confusion', 'cause': 'similar furniture', 'holds': wrong_place,
     'evidence': concat('step ', place.step, ' placed on ', place.receptacle, ', not ', dest)},
    {'rule': 4, 'class': 'Key Action Missing', 'cause': 'closed door', 'holds': door IS NOT NULL AND len(opened) = 0,
     'evidence': concat('step ', door, ' met a closed door, none was opened')},
    {'rule': 5, 'class': 'Lost Memory', 'cause': 'oscillation', 'holds': swing.length >= 4,
     'evidence': concat(swing.length, ' nav_to between ', swing.one, ' and ', swing.other, ' from step ', swing.first_step)},
    {'rule': 6, 'class': 'Key Action Missing', 'cause': 'closed door',
     'holds': src_door = 'closed' AND NOT list_contains(opened, src)
       OR dest_door = 'closed' AND pick.goal_object AND NOT list_contains(opened, dest),
     'evidence': concat('door of ', src, ' or ', dest, ' never opened')},
    {'rule': 7, 'class': 'Key Action Missing', 'cause': 'no question', 'holds': unasked AND pick IS NULL AND candidates > 1,
     'evidence': concat('no ask, ', candidates, ' candidates seen, none picked')},
    {'rule': 8, 'class': 'Key Action Missing', 'cause': if(pick IS NULL, 'never picked', 'never placed'),
     'holds': end_reason = 'finished' AND (pick IS NULL OR NOT regexp_matches(word, '[lm]')),
     'evidence': concat('finish after ', length, ' decisions')},
    {'rule': 9, 'class': 'Lost Memory', 'cause': 'no progress', 'holds': end_reason = 'horizon',
     'evidence': concat(length, ' decisions')},
    {'rule': 10, 'class': 'Other', 'cause': 'other', 'holds': true,
     'evidence': concat('last pick ', pick.object, ', last place ', place.receptacle)}
  ] AS rules
  FROM findings
)
SELECT *, unnest([rule FOR rule IN rules IF rule.holds][1]) FROM judgements;

CREATE TABLE answer.failed_episodes AS
SELECT class, cause, evidence, completion AS done, length, end_reason, policy, family, task_id, episode_id, trace
FROM judged ORDER BY rule, policy, task_id, episode_id;

CREATE TABLE answer.failures AS
SELECT
  policy, class, cause, count(*) AS episodes,
  count(*) / (SELECT count(*) FROM judged every WHERE every.policy = judged.policy) AS share, min(trace) AS example
FROM judged GROUP BY policy, class, cause ORDER BY policy, episodes DESC, class, cause;

CREATE TABLE answer.errors AS
WITH totals AS (SELECT policy, call.tool AS tool, count(*) AS total FROM calls GROUP BY ALL)
SELECT
  policy, tool, call.error_code AS error, call.error_class AS class, count(*) AS calls, count(*) / any_value(total) AS share
FROM calls JOIN totals USING (policy) WHERE call.tool = tool AND error IS NOT NULL
GROUP BY ALL ORDER BY calls DESC, policy, tool, error;

CREATE TABLE answer.error_classes AS
SELECT
  policy, tool, count(*) AS calls,
  count(*) / (SELECT count(*) FROM episodes WHERE episodes.policy = calls.policy) AS an_episode,
  tally(call.error_code IS NULL) AS worked, tally(call.error_class = 'moderate') AS moderate,
  tally(call.error_class = 'severe') AS severe, share(call.error_code IS NOT NULL) AS failed
FROM calls, unnest([call.tool, 'all']) AS names(tool) GROUP BY policy, tool ORDER BY policy, tool = 'all', tool;

CREATE TABLE answer.object_confusions AS
WITH things AS (SELECT task_digest, unnest(objects) AS thing FROM tasks)
SELECT
  policy, target_category AS wanted, target_caption AS wanted_caption, thing.category AS picked, thing.caption AS picked_caption,
  picked = wanted AS alike, count(*) AS picks, count(DISTINCT episode_id) AS episodes,
  count(DISTINCT if(success, episode_id, NULL)) AS won, min(trace) AS example
FROM calls LEFT JOIN things ON things.task_digest = calls.task_digest AND thing.instance = call.object
WHERE letter(call) = 'q' GROUP BY ALL ORDER BY picks DESC, policy, wanted, wanted_caption, picked, picked_caption;

CREATE TABLE answer.receptacle_confusions AS
SELECT
  policy, scene_id, dest AS wanted, call.receptacle AS placed_on, list_contains(dest_distractors, placed_on) AS alike,
  placed_on = src AS source, count(*) AS places, count(DISTINCT episode_id) AS episodes,
  count(DISTINCT if(success, episode_id, NULL)) AS won, min(trace) AS example
FROM calls JOIN (SELECT task_digest, dest_distractors FROM tasks) USING (task_digest)
WHERE letter(call) = 'l' AND call.goal_object AND NOT call.goal_receptacle
GROUP BY ALL ORDER BY places DESC, policy, scene_id, wanted, placed_on, alike, source;
