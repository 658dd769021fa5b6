-- failed episodes by policy and rule-based class, the first rule that holds
WITH classes AS (
  SELECT policy,
    CASE
      WHEN sequence_match(steps, 'pick[ok and not goal_object] !pick[ok]* $') THEN 'Object Confusion'
      WHEN fuzzy AND asks = 0 OR NOT sequence_match(steps, 'place[ok]')
        OR (sequence_match(steps, '_[error = "door_closed"]') AND NOT sequence_match(steps, 'open[ok]')) THEN 'Key Action Missing'
      WHEN oscillation(steps).length >= 4 THEN 'Lost Memory'
      ELSE 'Other'
    END AS class
  FROM episodes
  WHERE NOT success
)
SELECT policy, class, count(*) AS episodes
FROM classes
GROUP BY policy, class
ORDER BY policy, class
