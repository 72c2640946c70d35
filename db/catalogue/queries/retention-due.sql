-- retention-due: Which visitors' sessions have been kept for as long as they may be?
-- `stratalux-db purge` removes them. The time counts from the end of the session, or from its start where it never ended; a
-- withdrawn consent is due at once. The view retention_ends, up to now.
-- parameters: rig limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column visitor      text   pseudonym
-- column reason       text   the retention class (short, standard, long), or consent withdrawn
-- column due          time   UTC
-- column overdue_days days
-- column bytes        bytes  that it would free
SELECT e.id AS session, s.started_wall_ns AS started, e.rig, e.visitor, e.reason, e.due_wall_ns AS due,
       (:now_ns - e.due_wall_ns) / 86400e9 AS overdue_days, e.bytes
FROM retention_ends e JOIN sessions s ON s.number = e.session
WHERE e.due_wall_ns <= :now_ns AND (:rig IS NULL OR e.rig = :rig)
ORDER BY due, e.session
LIMIT coalesce(:limit, -1)
