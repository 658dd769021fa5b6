-- What a store holds, and how well policies do.

CREATE TABLE answer.overview AS
SELECT
  policy, checkpoint, backend, profile, preset, sim_version, build,
  count(*) AS episodes, tally(end_reason IS NULL) AS broken_off,
  count(DISTINCT task_digest) AS tasks, count(DISTINCT scene_digest) AS scenes, count(DISTINCT seed) AS seeds,
  count(DISTINCT run_id) AS runs, sum(ifnull(len(steps), 0)) AS decisions, sum(trace_bytes) / 1e6 AS megabytes
FROM episodes GROUP BY ALL
ORDER BY episodes DESC, policy, checkpoint, backend, profile, preset, sim_version, build;

CREATE TABLE answer.quarantined AS
SELECT reason, count(*) AS files, min(trace) AS example FROM quarantine GROUP BY reason ORDER BY files DESC, reason;

CREATE TABLE answer.end_reasons AS
SELECT
  policy, ifnull(end_reason, 'broken off') AS reason, count(*) AS episodes,
  count(*) / (SELECT count(*) FROM told every WHERE every.policy = told.policy) AS share,
  share(success) AS success, avg(completion) AS completion, avg(length) AS length
FROM told GROUP BY policy, end_reason ORDER BY policy, count(*) DESC, reason;

-- Each episode played to an end twice: under its family and under `all`.
CREATE VIEW by_family AS
SELECT played.* REPLACE (name AS family) FROM played, unnest([family, 'all']) AS names(name);

CREATE TABLE answer.benchmark AS
SELECT
  policy, family, count(*) AS episodes, share(success) AS success, avg(completion) AS completion, avg(total_reward) AS reward,
  avg(length) AS length, avg(asks) AS asks, avg(spl) AS spl
FROM by_family GROUP BY policy, family ORDER BY policy, family_order(family);

CREATE TABLE answer.success_intervals AS
WITH counts AS (
  SELECT policy, family, count(*) AS episodes, count(DISTINCT task_digest) AS tasks, tally(success) AS successes
  FROM by_family GROUP BY policy, family
)
SELECT *, successes / episodes AS success, low(successes, episodes) AS low, high(successes, episodes) AS high
FROM counts ORDER BY policy, family_order(family);

CREATE TABLE answer.main_results AS
WITH tallies AS (SELECT policy, family, successes || '/' || episodes AS tally FROM answer.success_intervals),
families AS (PIVOT tallies ON family IN ('FDP', 'FODP', 'FDO', 'SUL', 'all') USING any_value(tally))
SELECT
  policy, ifnull(FDP, '-') AS fdp, ifnull(FODP, '-') AS fodp, ifnull(FDO, '-') AS fdo, ifnull(SUL, '-') AS sul, families."all",
  success, low, high
FROM families JOIN answer.success_intervals every USING (policy) WHERE every.family = 'all'
ORDER BY success DESC, policy;

CREATE TABLE answer.real_world AS
SELECT
  policy, family, count(*) AS episodes, share(success) AS success, avg(length) AS steps, avg(spl) AS spl, avg(asks) AS asks,
  avg(list_sum([call.latency_ns FOR call IN steps]) / 1e9) AS latency_s
FROM by_family GROUP BY policy, family ORDER BY policy, family_order(family);

CREATE TABLE answer.primitives AS
WITH aims AS (
  SELECT
    policy, scene_digest, call.tool AS tool, call.error_code IS NULL AS worked,
    ifnull(call.receptacle, [mark.id FOR mark IN call.marker_map IF mark.marker::VARCHAR = call.argument][1]) AS aim,
    list_max([it.target FOR it IN measurements IF it.kind = 'primitive' AND it.step = call.step]) AS told
  FROM calls WHERE call.tool IN ('open', 'close', 'pick', 'place')
),
skills AS (
  SELECT policy, worked, unnest([if(tool = 'place', 'place ' || coalesce(place.category, told, '?'), tool), 'all']) AS skill
  FROM aims JOIN scenes USING (scene_digest) LEFT JOIN unnest(scenes.receptacles) AS furniture(place) ON place.receptacle = aim
)
SELECT
  policy, skill, count(*) AS calls, tally(worked) AS succeeded, share(worked) AS success,
  low(tally(worked), count(*)) AS low, high(tally(worked), count(*)) AS high
FROM skills GROUP BY policy, skill ORDER BY policy, skill = 'all', skill;

CREATE TABLE answer.repeatability AS
WITH trials AS (
  SELECT unnest([ifnull(it.target, '?'), 'all']) AS target, it
  FROM told, unnest(told.measurements) AS log(it) WHERE it.kind = 'alignment'
)
SELECT
  target, count(*) AS trials, avg(it.odometry_error_m * 100) AS odometry_cm, stddev_samp(it.odometry_error_m * 100) AS odometry_sd_cm,
  avg(abs(it.yaw_error_rad) * 180 / pi()) AS yaw_deg, stddev_samp(abs(it.yaw_error_rad) * 180 / pi()) AS yaw_sd_deg,
  avg(it.image_shift_px) AS shift_px, stddev_samp(it.image_shift_px) AS shift_sd_px, sqrt(avg(it.image_rmse_px ** 2)) AS rmse_px
FROM trials GROUP BY target ORDER BY target = 'all', target;

CREATE TABLE answer.rollouts AS
WITH questions AS (SELECT episode_id, bool_or(useful) AS useful FROM answer.questions GROUP BY episode_id)
SELECT
  policy, count(*) AS episodes, share(success) AS success,
  share(regexp_matches(word, 'nsg[pq]nr[lm]')) AS canonical,
  share(regexp_matches(word, 'n.*s.*g.*[pq].*n.*r.*[lm]')) AS in_order,
  share(questions.episode_id IS NOT NULL) AS asked, share(useful) AS asked_well, tally(NOT success) AS failed,
  share(regexp_matches(word, '[pq].*[lm]'), NOT success) AS procedure_right,
  share(regexp_matches(word, '[pq].*m[^lm]*$'), NOT success) AS wrong_object
FROM played LEFT JOIN questions USING (episode_id) GROUP BY policy ORDER BY policy;

CREATE TABLE answer.funnel AS
WITH facts AS (
  SELECT
    *, [call FOR call IN steps IF call.error_code IS NULL] AS done,
    [call.step FOR call IN done IF call.tool = 'pick' AND call.goal_object][1] AS picked,
    flatten([call.new_objects FOR call IN steps]) || [sight.object FOR sight IN start_objects] AS seen
  FROM played
),
stages AS (
  SELECT policy, [
    {'name': '1 told', 'reached': true},
    {'name': '2 went to the source', 'reached': len([1 FOR c IN done IF c.tool = 'nav_to' AND c.receptacle = src]) > 0},
    {'name': '3 saw the target', 'reached': list_contains(seen, target)},
    {'name': '4 picked the right object', 'reached': picked IS NOT NULL},
    {'name': '5 went to the destination',
     'reached': len([1 FOR c IN done IF c.tool = 'nav_to' AND c.receptacle = dest AND c.step > picked]) > 0},
    {'name': '6 placed the object right',
     'reached': len([1 FOR c IN done IF c.tool = 'place' AND c.goal_object AND c.goal_receptacle]) > 0},
    {'name': '7 success', 'reached': success}
  ] AS stages
  FROM facts
),
counts AS (
  SELECT
    policy, number, any_value(stages[number].name) AS stage, tally(stages[number].reached) AS reached,
    tally(list_bool_and([stage.reached FOR stage IN stages[:number]])) AS passed, count(*) AS episodes
  FROM stages, range(1, 8) AS numbers(number) GROUP BY policy, number
)
SELECT
  now.policy, now.stage, now.reached, now.passed, now.passed / now.episodes AS share,
  now.passed / nullif(before.passed, 0) AS step_share
FROM counts now LEFT JOIN counts before ON before.policy = now.policy AND before.number = now.number - 1
ORDER BY now.policy, now.number;

CREATE TABLE answer.distractors AS
SELECT
  policy, len([object FOR object IN objects IF object.role = 'distractor']) AS distractors, count(*) AS episodes,
  count(DISTINCT task_digest) AS tasks, share(success) AS success,
  low(tally(success), count(*)) AS low, high(tally(success), count(*)) AS high,
  share(contains(word, 'q')) AS wrong_pick, avg(asks) AS asks, avg(length) AS length
FROM played JOIN (SELECT task_digest, objects FROM tasks) USING (task_digest)
GROUP BY policy, distractors ORDER BY policy, distractors;

CREATE TABLE answer.success_by_budget AS
SELECT
  policy, budget AS decisions, tally(success AND length <= budget) AS successes, share(success AND length <= budget) AS success
FROM played JOIN (SELECT DISTINCT policy, length AS budget FROM played WHERE success) USING (policy)
GROUP BY policy, budget ORDER BY policy, budget;
