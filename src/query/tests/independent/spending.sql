-- Rewards, changes of the graphs, prompt groups, and what decisions and time are spent on.

CREATE TABLE answer.reward_components AS
WITH terms AS (
  SELECT policy, preset, term FROM played, unnest(flatten([call.terms FOR call IN steps])) AS of_episode(term)
),
totals AS (SELECT policy, preset, count(*) AS episodes FROM played GROUP BY ALL)
SELECT
  policy, preset, term.component AS component, sum(term.value) / any_value(episodes) AS mean,
  min(term.value) AS low, max(term.value) AS high, count(*) AS terms
FROM terms JOIN totals USING (policy, preset) GROUP BY ALL ORDER BY ALL;

CREATE TABLE answer.rescored_rewards AS
WITH gains AS (
  SELECT
    policy, e.preset AS recorded, r.preset, version, e.total_reward AS before, r.total_reward AS after, after - before AS gain
  FROM played e JOIN rescored r USING (episode_id, trace_digest)
)
SELECT
  policy, recorded, preset, version, count(*) AS episodes, avg(before) AS reward_recorded, avg(after) AS reward,
  avg(gain) AS difference, tally(gain > 0) AS higher, tally(gain < 0) AS lower, min(gain) AS least, max(gain) AS most
FROM gains GROUP BY policy, recorded, preset, version ORDER BY policy, recorded, preset, version;

CREATE TABLE answer.graph_events AS
WITH changes AS (
  SELECT
    call.tool AS tool, call.error_code IS NULL AS succeeded, call.object AS acted_on, episode_id, trace,
    unnest(call.changes) AS change
  FROM calls
  UNION ALL
  SELECT '(start)', true, NULL, episode_id, trace, unnest(start_changes) FROM told
)
SELECT
  tool, succeeded, change.event AS event, change.receptacle = 'floor' AS floor,
  tally(change.authority = 'physics') AS physics, tally(change.authority = 'registry') AS registry,
  tally(change.object <> ifnull(acted_on, '')) AS bystanders, count(DISTINCT episode_id) AS episodes, min(trace) AS example
FROM changes GROUP BY tool, succeeded, event, floor ORDER BY tool, succeeded, event, floor;

CREATE TABLE answer.groups AS
SELECT
  group_id, min(policy) AS policy, min(task_id) AS task_id, count(*) AS rollouts, tally(success) AS successes,
  count(DISTINCT task_digest) AS tasks, avg(discounted_return) AS mean, stddev_pop(discounted_return) AS std,
  min(discounted_return) AS worst, max(discounted_return) AS best, count(DISTINCT discounted_return) > 1 AS signal
FROM grouped GROUP BY group_id ORDER BY group_id;

CREATE TABLE answer.group_advantages AS
SELECT
  group_id, rollout_index, e.policy, e.task_id, success, total_reward, discounted_return,
  (discounted_return - mean) / (std + 1e-6) AS advantage, episode_id, trace
FROM grouped e JOIN answer.groups USING (group_id) ORDER BY group_id, rollout_index, episode_id;

CREATE TABLE answer.latency AS
WITH timed AS (SELECT policy, episode_id, call, call.latency_ns / 1e9 AS s FROM calls WHERE call.latency_ns IS NOT NULL)
SELECT
  policy, count(*) AS decisions, avg(s) AS mean_s, quantile_disc(s, 0.5) AS p50_s, quantile_disc(s, 0.9) AS p90_s,
  quantile_disc(s, 0.99) AS p99_s, max(s) AS max_s, sum(s) / count(DISTINCT episode_id) AS episode_s,
  avg(call.prompt_tokens) AS prompt_tokens, avg(call.completion_tokens) AS completion_tokens
FROM timed GROUP BY policy ORDER BY policy;

CREATE TABLE answer.longest_episodes AS
WITH spent AS (
  SELECT
    policy, family, task_id, success, end_reason, len(steps) AS decisions, occurrences(word, '[A-Z]') AS failed,
    list_sum([call.latency_ns FOR call IN steps]) / 1e9 AS latency_s,
    list_max([call.sim_step FOR call IN steps]) / 240 AS simulated_s, path_length_m AS driven_m, episode_id, trace
  FROM told WHERE word <> ''
),
ranked AS (
  SELECT
    *, row_number() OVER (
      PARTITION BY policy ORDER BY decisions DESC, latency_s DESC NULLS LAST, family, task_id, episode_id
    ) AS place
  FROM spent
)
SELECT * EXCLUDE place FROM ranked WHERE place <= 5 ORDER BY policy, place;

CREATE TABLE answer.effort AS
WITH again AS (
  SELECT
    episode_id, (call.tool, call.arguments) = lag((call.tool, call.arguments)) OVER steps AS same
  FROM calls WINDOW steps AS (PARTITION BY episode_id ORDER BY call.step)
),
repeats AS (SELECT episode_id, tally(same) AS repeated FROM again GROUP BY episode_id),
words AS (SELECT policy, success, word, ifnull(repeated, 0) AS repeated FROM told LEFT JOIN repeats USING (episode_id)),
sums AS (
  SELECT policy, success, count(*) AS episodes, string_agg(word, '') AS word, sum(repeated) AS repeated FROM words GROUP BY ALL
)
SELECT
  policy, success, episodes, length(word) AS decisions, occurrences(word, '(?i)n') / nullif(decisions, 0) AS moving,
  occurrences(word, '(?i)[wsrg]') / nullif(decisions, 0) AS looking,
  occurrences(word, '(?i)[pqlmoc]') / nullif(decisions, 0) AS handling,
  occurrences(word, '(?i)a') / nullif(decisions, 0) AS asking,
  occurrences(word, '[A-Z]') / nullif(decisions, 0) AS failed, repeated / nullif(decisions, 0) AS repeated
FROM sums ORDER BY policy, success;

CREATE TABLE answer.tool_transitions AS
WITH tools AS (
  SELECT policy, episode_id, call.step AS step, call.tool AS tool FROM calls
  UNION ALL SELECT policy, episode_id, -1, '(start)' FROM told
),
pairs AS (
  SELECT policy, tool, lead(tool, 1, '(end)') OVER (PARTITION BY episode_id ORDER BY step) AS next FROM tools
)
SELECT policy, tool, next, count(*) AS calls, count(*) / any_value(total) AS share
FROM pairs JOIN (SELECT policy, tool, count(*) AS total FROM tools GROUP BY ALL) USING (policy, tool)
GROUP BY policy, tool, next ORDER BY policy, tool, calls DESC, next;

-- Default patterns: pick[failed] .. pick[ok], and show_object_by_category[ok] gaze_at[ok] pick[ok].
CREATE TABLE answer.episodes_matching AS
SELECT
  policy, family, task_id, success, length(regexp_extract(word, '^(.*?)P.*[pq]', 1)) AS first,
  first + length(regexp_extract(word, 'P.*[pq]')) - 1 AS last, occurrences(word, 'P.*[pq]') AS times, episode_id, trace
FROM told WHERE regexp_matches(word, 'P.*[pq]') ORDER BY policy, family, task_id, episode_id;

CREATE TABLE answer.pattern_success AS
WITH found AS (SELECT *, regexp_matches(word, 'sg[pq]') AS matches FROM played)
SELECT
  policy, family, count(*) AS episodes, tally(matches) AS matching, share(success, matches) AS success_with,
  share(success, NOT matches) AS success_without
FROM found GROUP BY policy, family ORDER BY policy, family;

CREATE TABLE answer.execution AS
WITH logs AS (
  SELECT
    policy, call, [it FOR it IN measurements IF it.kind = 'vla' AND it.step = call.step] AS thought,
    [it FOR it IN measurements IF it.kind = 'primitive' AND it.step = call.step] AS done
  FROM calls
),
timed AS (
  SELECT
    policy, call.tool AS tool, call.error_code IS NOT NULL AS failed,
    ifnull(call.duration_ns, list_sum([it.duration_ns FOR it IN done])) / 1e9 AS took_s,
    nullif(len(thought), 0) AS inferences, list_sum([it.duration_ns FOR it IN thought]) AS thought_ns,
    list_sum([it.control_steps FOR it IN done]) AS control_steps
  FROM logs
)
SELECT
  policy, tool, count(*) AS calls, tally(failed) AS failed, avg(took_s) AS mean_s, max(took_s) AS max_s,
  avg(inferences) AS inferences, sum(thought_ns) / sum(inferences) / 1e6 AS inference_ms, avg(control_steps) AS control_steps
FROM timed WHERE coalesce(took_s, inferences, control_steps) IS NOT NULL GROUP BY policy, tool ORDER BY policy, tool;
