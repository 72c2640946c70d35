-- retention-due: Which visitors' sessions have been kept for as long as they may be?
-- `stratalux-db purge` removes them. The time counts from the end of the session, or from its start where it never ended; a
-- withdrawn consent is due at once.
-- parameters: rig limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column visitor      text   pseudonym
-- column reason       text   the retention class (short, standard, long), or consent withdrawn
-- column due          time   UTC
-- column overdue_days days
-- column bytes        bytes  that it would free
WITH visits AS (
  SELECT s.*, coalesce(nullif(s.finished_wall_ns, 0), s.started_wall_ns) + retention_days(s.retention) * 86400000000000
           AS end_ns,
         CASE WHEN json_valid(s.consent_json) THEN json_extract(s.consent_json, '$.given_wall_ns') END AS given_wall_ns
  FROM sessions s
  WHERE s.kind = 'visitor' AND (:rig IS NULL OR s.rig = :rig)),
-- Of the consent the session was made under; of the visitor's newest where that one is not known here.
asked AS (
  SELECT v.*, (SELECT c.withdrawn_wall_ns FROM consents c WHERE c.number = coalesce(
                 (SELECT max(m.number) FROM consents m WHERE m.visitor = v.visitor AND m.given_wall_ns = v.given_wall_ns),
                 (SELECT max(m.number) FROM consents m WHERE m.visitor = v.visitor))) AS withdrawn_ns
  FROM visits v)
SELECT id AS session, started_wall_ns AS started, rig, visitor,
       CASE WHEN withdrawn_ns IS NULL THEN retention ELSE 'consent withdrawn' END AS reason,
       coalesce(withdrawn_ns, end_ns) AS due, (:now_ns - coalesce(withdrawn_ns, end_ns)) / 86400e9 AS overdue_days,
       stored_bytes AS bytes
FROM asked
WHERE coalesce(withdrawn_ns, end_ns) <= :now_ns
ORDER BY due, number
LIMIT coalesce(:limit, -1)
