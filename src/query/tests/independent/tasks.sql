-- Policies compared task by task.

CREATE VIEW on_tasks AS
SELECT
  policy, task_digest, any_value(family) AS family, any_value(task_id) AS task_id, count(*) AS episodes,
  count(DISTINCT seed) AS seeds, tally(success) AS successes, share(success) AS success, share(success) > 0.5 AS solved,
  min(trace) FILTER (success) AS success_trace, min(trace) FILTER (NOT success) AS failure_trace
FROM played GROUP BY policy, task_digest;

-- McNemar's exact test: twice the tail of a fair coin thrown `only_a + only_b` times.
CREATE TABLE answer.policy_comparison AS
WITH pairs AS (
  SELECT
    a.policy AS a, b.policy AS b, count(*) AS tasks, avg(a.success) AS success_a, avg(b.success) AS success_b,
    tally(a.solved AND NOT b.solved) AS only_a, tally(b.solved AND NOT a.solved) AS only_b,
    bootstrap(list(a.success - b.success ORDER BY task_digest), 2000, 7) AS spread
  FROM on_tasks a JOIN on_tasks b USING (task_digest) WHERE a.policy < b.policy GROUP BY a.policy, b.policy
),
tails AS (
  SELECT *, only_a + only_b AS n, [
    exp(lgamma(n + 1) - lgamma(k + 1) - lgamma(n - k + 1) - n * ln(2)) FOR k IN range(least(only_a, only_b)::INT + 1)
  ] AS tail
  FROM pairs
)
SELECT
  a, b, tasks, success_a, success_b, only_a, only_b, least(2 * list_sum(tail), 1) AS p, success_a - success_b AS difference,
  spread[1] AS low, spread[2] AS high
FROM tails ORDER BY a, b;

CREATE TABLE answer.regressions AS
SELECT
  a.policy AS a, b.policy AS b, a.family, a.task_id, a.success AS success_a, b.success AS success_b,
  a.episodes AS episodes_a, b.episodes AS episodes_b, a.success_trace AS trace_a, b.failure_trace AS trace_b
FROM on_tasks a, on_tasks b WHERE a.task_digest = b.task_digest AND a.solved AND NOT b.solved
ORDER BY a.policy, b.policy, a.family, a.task_id, a.task_digest;

CREATE TABLE answer.hardest_tasks AS
WITH causes AS (
  SELECT task_digest, name FROM judged GROUP BY task_digest, name
  QUALIFY row_number() OVER (PARTITION BY task_digest ORDER BY count(*) DESC, name) = 1
)
SELECT
  any_value(family) AS family, any_value(task_id) AS task_id, count(DISTINCT policy) AS policies,
  count(DISTINCT policy) FILTER (success) AS solved_by, count(*) AS episodes, share(success) AS success,
  avg(completion) AS completion, avg(length) AS length, any_value(name) AS failure, min(instruction) AS instruction
FROM played LEFT JOIN causes USING (task_digest)
GROUP BY task_digest ORDER BY success, round(avg(completion), 6), family, task_id, task_digest;

CREATE TABLE answer.flaky_tasks AS
SELECT policy, family, task_id, episodes, seeds, successes, success, success_trace, failure_trace
FROM on_tasks WHERE success_trace IS NOT NULL AND failure_trace IS NOT NULL ORDER BY policy, family, task_id, task_digest;
