SELECT
  policy,
  coalesce(family, 'all') AS family,
  count(*) AS episodes,
  count(DISTINCT task_digest) AS tasks,
  count(*) FILTER (WHERE success) AS successes,
  avg(CAST(success AS DOUBLE)) AS success,
  wilson_low(count(*) FILTER (WHERE success), count(*)) AS low,
  wilson_high(count(*) FILTER (WHERE success), count(*)) AS high
FROM episodes
WHERE end_reason IS NOT NULL
GROUP BY GROUPING SETS ((policy, family), (policy))
ORDER BY policy, CASE family WHEN 'FDP' THEN 1 WHEN 'FODP' THEN 2 WHEN 'FDO' THEN 3 WHEN 'SUL' THEN 4 ELSE 5 END