WITH of_episode AS (
  SELECT
    episode_id, count(*) AS asks, count(*) FILTER (WHERE useful) AS useful, count(reply) AS answered,
    count(next_pick) AS picked, count(*) FILTER (WHERE next_pick = 'right') AS picked_right
  FROM questions
  GROUP BY episode_id
)
SELECT
  e.policy, e.fuzzy,
  count(*) AS episodes,
  1.0 * coalesce(sum(q.asks), 0) / count(*) AS asks,
  1.0 * count(q.asks) / count(*) AS asked,
  1.0 * sum(q.useful) / sum(q.asks) AS useful,
  1.0 * sum(q.answered) / sum(q.asks) AS answered,
  1.0 * sum(q.picked_right) / nullif(sum(q.picked), 0) AS picked_right,
  avg(CAST(e.success AS DOUBLE)) FILTER (WHERE q.asks IS NOT NULL) AS success_asked,
  avg(CAST(e.success AS DOUBLE)) FILTER (WHERE q.asks IS NULL) AS success_unasked
FROM episodes e
LEFT JOIN of_episode q ON q.episode_id = e.episode_id
WHERE e.end_reason IS NOT NULL
GROUP BY e.policy, e.fuzzy
ORDER BY e.policy, e.fuzzy