-- quarantined
--
-- Why files were left out at ingest, the most frequent reason first.
--
-- Columns:
--   reason   what is wrong with them
--   files    how many
--   example  one of them
--
-- Example: reel query --store store --named quarantined
SELECT reason, count(*) AS files, min(trace) AS example
FROM quarantine
GROUP BY reason
ORDER BY files DESC, reason
