-- disk-use: What takes the space?
-- Payloads of frames, from the totals kept with each commit; fits and previews are not counted.
-- parameters: since until rig limit
-- column rig             text
-- column kind            text   visitor, calibration, dark, flat or response
-- column status          text   recording, complete, degraded or failed
-- column sessions        number
-- column frames          number
-- column bytes           bytes
-- column bytes_per_frame bytes
-- column percent         number of all that is listed
SELECT s.rig, s.kind, s.status, count(*) AS sessions, sum(s.frame_count) AS frames, sum(s.stored_bytes) AS bytes,
       sum(s.stored_bytes) / nullif(sum(s.frame_count), 0) AS bytes_per_frame,
       round(100.0 * sum(s.stored_bytes) / nullif(sum(sum(s.stored_bytes)) OVER (), 0), 1) AS percent
FROM sessions s
WHERE s.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND s.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR s.rig = :rig)
GROUP BY s.rig, s.kind, s.status
ORDER BY bytes DESC, s.rig, s.kind, s.status
LIMIT coalesce(:limit, -1)
