-- discounted returns from the steps' rewards, normed within their groups
WITH returns AS (
  SELECT coalesce(group_id, concat(task_id, policy)) AS group_key, discounted(step_values(steps, 'reward'), 0.99) AS j
  FROM episodes
),
groups AS (
  SELECT array_agg(j) AS js, avg(j) AS mean, stddev_pop(j) AS std
  FROM returns
  GROUP BY group_key
),
normed AS (
  SELECT j, (j - mean) / (std + 1e-6) AS advantage
  FROM (SELECT unnest(js) AS j, mean, std FROM groups)
)
SELECT count(*) AS episodes, round(sum(j), 6) AS sum_j, round(sum(abs(advantage)), 6) AS sum_abs,
  round(max(advantage), 6) AS max
FROM normed
