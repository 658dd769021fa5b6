-- repeatability
--
-- The paper's table of navigation and gaze: how far off a robot is after the same command again and again, by target and over
-- all. From what robots measured themselves; a deviation is the sample standard deviation.
--
-- Columns:
--   target                         at what, as the robot calls it; `?`: it does not say; `all`: every target
--   trials                         how often it was measured
--   odometry_cm, odometry_sd_cm    distance to the wanted position, centimetres: mean and deviation
--   yaw_deg, yaw_sd_deg            difference in heading, degrees
--   shift_px, shift_sd_px          shift of the image, pixels
--   rmse_px                        error of the image's registration, pixels: root mean square
--
-- Parameters:
--   $policy = %  who decided, as in LIKE; %: any
--
-- Example: reel query --store store --named repeatability
WITH trials AS (
  SELECT
    coalesce(target, '?') AS target, 100 * odometry_error_m AS odometry_cm, degrees(abs(yaw_error_rad)) AS yaw_deg,
    image_shift_px, image_rmse_px
  FROM measurements
  WHERE kind = 'alignment' AND parent_trace IS NULL AND policy LIKE CAST($policy AS VARCHAR)
)
SELECT
  coalesce(target, 'all') AS target,
  count(*) AS trials,
  avg(odometry_cm) AS odometry_cm,
  stddev(odometry_cm) AS odometry_sd_cm,
  avg(yaw_deg) AS yaw_deg,
  stddev(yaw_deg) AS yaw_sd_deg,
  avg(image_shift_px) AS shift_px,
  stddev(image_shift_px) AS shift_sd_px,
  sqrt(avg(image_rmse_px * image_rmse_px)) AS rmse_px
FROM trials
GROUP BY GROUPING SETS ((target), ())
HAVING count(*) > 0
ORDER BY CASE target WHEN 'all' THEN 1 ELSE 0 END, target
