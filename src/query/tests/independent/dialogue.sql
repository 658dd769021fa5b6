-- Questions to the user and what comes of them.

CREATE TABLE answer.questions AS
WITH picks AS (
  SELECT episode_id, call.step AS step, call.goal_object AS of_goal
  FROM calls WHERE call.tool = 'pick' AND call.error_code IS NULL
)
SELECT
  policy, family, task_id, success, call.step AS step, call.candidate_count AS candidate_count,
  call.candidate_count > 1
    OR preset = 'paper' AND len([term FOR term IN call.terms IF term.component = 'ask' AND term.value > 0]) > 0 AS useful,
  call.question AS question, call.reply AS reply, call.reply_source AS source,
  occurrences(call.reply, '[^\s\pZ]+') AS words,
  if(of_goal, 'right', if(NOT of_goal, 'wrong', NULL)) AS next_pick,
  calls.episode_id, trace
FROM calls ASOF LEFT JOIN picks ON picks.episode_id = calls.episode_id AND calls.call.step < picks.step
WHERE call.tool = 'ask' AND call.error_code IS NULL
ORDER BY policy, family, task_id, calls.episode_id, call.step;

CREATE TABLE answer.question_summary AS
WITH asked AS (
  SELECT e.policy, e.fuzzy, useful, reply, next_pick FROM played e JOIN answer.questions USING (episode_id)
),
questions AS (
  SELECT
    policy, fuzzy, count(*) AS asks, share(useful) AS useful, share(reply IS NOT NULL) AS answered,
    share(next_pick = 'right') AS picked_right
  FROM asked GROUP BY ALL
),
outcomes AS (
  SELECT policy, fuzzy, success, episode_id IN (SELECT episode_id FROM answer.questions) AS asked FROM played
)
SELECT
  policy, fuzzy, count(*) AS episodes, coalesce(any_value(asks), 0) / count(*) AS asks, share(asked) AS asked,
  any_value(useful) AS useful, any_value(answered) AS answered, any_value(picked_right) AS picked_right,
  share(success, asked) AS success_asked, share(success, NOT asked) AS success_unasked
FROM outcomes LEFT JOIN questions USING (policy, fuzzy)
GROUP BY policy, fuzzy ORDER BY policy, fuzzy;

CREATE TABLE answer.user_fidelity AS
WITH sources AS (
  SELECT
    policy, source, count(*) AS answers, avg(words) AS words,
    tally(next_pick = 'right') AS led_right, tally(next_pick = 'wrong') AS led_wrong,
    tally(next_pick IS NULL) AS led_nowhere,
    count(DISTINCT played.episode_id) AS episodes, count(DISTINCT task_digest) AS tasks,
    count(DISTINCT CASE WHEN played.success THEN played.episode_id END) AS successes
  FROM answer.questions LEFT JOIN played USING (policy, episode_id)
  WHERE reply IS NOT NULL
  GROUP BY policy, source
)
SELECT *, successes / nullif(episodes, 0) AS success, low(successes, episodes) AS low, high(successes, episodes) AS high
FROM sources ORDER BY policy, source;

CREATE TABLE answer.vocabulary_misses AS
WITH missed AS (
  SELECT
    lower(trim(call.argument)) AS word, call.match_source AS source, call.step AS step, episode_id, policy, success, trace,
    call.error_code IS NOT NULL AS failed
  FROM episodes, unnest(episodes.steps) AS of_episode(call)
  WHERE (parent_call IS NULL OR call.step >= parent_call)
  AND call.match_source IS NOT NULL AND if(call.match_categories IS NULL, NOT call.query_known, len(call.match_categories) = 0)
)
SELECT
  word AS "query", source, count(*) AS calls, tally(failed) AS failed, count(DISTINCT episode_id) AS episodes,
  count(DISTINCT policy) AS policies, count(DISTINCT if(success, episode_id, NULL)) AS successes,
  min(trace) AS trace, arg_min(step, (trace, step)) AS step
FROM missed GROUP BY word, source ORDER BY calls DESC, "query", source;

CREATE TABLE answer.answer_fidelity AS
WITH opinions AS (
  SELECT episode_id, step, list_distinct(list(label)) AS labels FROM answer_labels GROUP BY ALL
),
answers AS (
  SELECT call.reply_source AS source, call.refused_replies AS refused, labels, if(len(labels) = 1, labels[1], NULL) AS agreed
  FROM calls LEFT JOIN opinions ON opinions.episode_id = calls.episode_id AND opinions.step = call.step
  WHERE call.tool = 'ask' AND call.error_code IS NULL AND call.reply IS NOT NULL
),
counts AS (
  SELECT
    source, count(*) AS answers, sum(refused) AS refused, count(labels) AS labelled, tally(agreed = 'faithful') AS faithful,
    tally(agreed = 'unclear') AS unclear, tally(agreed = 'unfaithful') AS unfaithful, tally(len(labels) > 1) AS disputed,
    count(agreed) AS settled
  FROM answers GROUP BY source
)
SELECT
  * EXCLUDE settled, faithful / nullif(settled, 0) AS share, low(faithful, settled) AS low, high(faithful, settled) AS high
FROM counts ORDER BY source;
