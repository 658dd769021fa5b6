-- per policy: episodes, share with the whole canonical pipeline, and how many reach each prefix of it
WITH facts AS (
  SELECT policy,
    CASE
      WHEN sequence_match(steps, 'nav_to show_object_by_category gaze_at? pick nav_to show_receptacles? place') THEN 7
      WHEN sequence_match(steps, 'nav_to show_object_by_category gaze_at? pick nav_to') THEN 6
      WHEN sequence_match(steps, 'nav_to show_object_by_category gaze_at? pick') THEN 4
      WHEN sequence_match(steps, 'nav_to show_object_by_category') THEN 3
      WHEN sequence_match(steps, 'nav_to') THEN 1
      ELSE 0
    END AS reached
  FROM episodes
)
SELECT policy, count(*) AS episodes, round(avg(CAST(reached = 7 AS INT)), 6) AS share,
  sum(CAST(reached >= 1 AS INT)) AS reached_1, sum(CAST(reached >= 2 AS INT)) AS reached_2,
  sum(CAST(reached >= 3 AS INT)) AS reached_3, sum(CAST(reached >= 4 AS INT)) AS reached_4,
  sum(CAST(reached >= 5 AS INT)) AS reached_5, sum(CAST(reached >= 6 AS INT)) AS reached_6,
  sum(CAST(reached >= 7 AS INT)) AS reached_7
FROM facts
GROUP BY policy
ORDER BY policy
