-- retention-due: Which sessions have been kept for as long as they may be?
-- `stratalux-db purge` removes them. The time counts from the end of the session.
-- parameters: rig limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column visitor      text   pseudonym
-- column retention    text   short, standard or long
-- column due          time   UTC
-- column overdue_days days
-- column bytes        bytes  that it would free
WITH dated AS (
  SELECT s.*, coalesce(s.finished_wall_ns, s.started_wall_ns) + retention_days(s.retention) * 86400000000000 AS due
  FROM sessions s
  WHERE s.status <> 'recording' AND (:rig IS NULL OR s.rig = :rig))
SELECT id AS session, started_wall_ns AS started, rig, visitor, retention, due, (:now_ns - due) / 86400e9 AS overdue_days,
       stored_bytes AS bytes
FROM dated
WHERE due <= :now_ns
ORDER BY due, number
LIMIT coalesce(:limit, -1)
