-- per policy and family: episodes, success rate, completion, length, asks, SPL
SELECT policy, family, count(*) AS episodes, round(avg(CAST(success AS INT)), 6) AS success,
  round(avg(completion), 6) AS completion, round(avg(length), 6) AS length, round(avg(asks), 6) AS asks,
  round(avg(spl), 6) AS spl
FROM episodes
GROUP BY policy, family
ORDER BY policy, family
