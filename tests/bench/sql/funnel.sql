-- per policy: episodes, share with the whole canonical pipeline, and how many reach each prefix of it; a tool that may be
-- left out is reached with the one before it
WITH reached AS (
  SELECT policy,
    CAST(sequence_match(steps, 'nav_to') AS INT) AS nav_to,
    CAST(sequence_match(steps, 'nav_to show_object_by_category') AS INT) AS show,
    CAST(sequence_match(steps, 'nav_to show_object_by_category gaze_at? pick') AS INT) AS pick,
    CAST(sequence_match(steps, 'nav_to show_object_by_category gaze_at? pick nav_to') AS INT) AS back,
    CAST(sequence_match(steps, 'nav_to show_object_by_category gaze_at? pick nav_to show_receptacles? place') AS INT) AS place
  FROM episodes
)
SELECT policy, count(*) AS episodes, round(avg(place), 6) AS share, sum(nav_to) AS reached_1, sum(show) AS reached_2,
  sum(show) AS reached_3, sum(pick) AS reached_4, sum(back) AS reached_5, sum(back) AS reached_6, sum(place) AS reached_7
FROM reached
GROUP BY policy
ORDER BY policy
