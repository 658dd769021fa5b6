-- overview
--
-- What a store holds: one row for each policy and way of recording, the largest first. Branches count.
--
-- Columns:
--   policy, checkpoint  who decided
--   backend, profile, preset, sim_version, build  how it was played, scored and recorded
--   episodes    how many
--   broken_off  of them without an end
--   tasks, scenes, seeds, runs  how many different ones
--   decisions   all together
--   megabytes   of the trace files, in units of 10^6 bytes
--
-- Example: reel query --store store --named overview
SELECT
  policy, checkpoint, backend, profile, preset, sim_version, build,
  count(*) AS episodes,
  count(*) FILTER (WHERE end_reason IS NULL) AS broken_off,
  count(DISTINCT task_digest) AS tasks,
  count(DISTINCT scene_digest) AS scenes,
  count(DISTINCT seed) AS seeds,
  count(DISTINCT run_id) AS runs,
  sum(cardinality(steps)) AS decisions,
  sum(trace_bytes) / 1e6 AS megabytes
FROM episodes
GROUP BY policy, checkpoint, backend, profile, preset, sim_version, build
ORDER BY episodes DESC, policy, checkpoint, backend, profile, preset, sim_version, build
