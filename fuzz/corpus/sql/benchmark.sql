SELECT
  policy,
  coalesce(family, 'all') AS family,
  count(*) AS episodes,
  avg(CAST(success AS DOUBLE)) AS success,
  avg(completion) AS completion,
  avg(total_reward) AS reward,
  avg(length) AS length,
  avg(asks) AS asks,
  avg(spl) AS spl
FROM episodes
WHERE end_reason IS NOT NULL
GROUP BY GROUPING SETS ((policy, family), (policy))
ORDER BY policy, CASE family WHEN 'FDP' THEN 1 WHEN 'FODP' THEN 2 WHEN 'FDO' THEN 3 WHEN 'SUL' THEN 4 ELSE 5 END