-- oldest-unfitted: Which visitors have waited longest for their fit?
-- Complete and degraded visitor sessions without any fit, oldest first.
-- parameters: since until rig limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column visitor      text   pseudonym
-- column status       text   complete or degraded
-- column frames       number stored
-- column waiting_days days   since the start
SELECT s.id AS session, s.started_wall_ns AS started, s.rig, s.visitor, s.status, s.frame_count AS frames,
       (:now_ns - s.started_wall_ns) / 86400e9 AS waiting_days
FROM sessions s
WHERE s.kind = 'visitor' AND s.status IN ('complete', 'degraded')
  AND NOT EXISTS (SELECT 1 FROM fits f WHERE f.session = s.number)
  AND s.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND s.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR s.rig = :rig)
ORDER BY s.number
LIMIT coalesce(:limit, -1)
