-- failures: Why were sessions degraded or failed?
-- Reasons that differ in their numbers alone are counted together (N stands for a number).
-- parameters: since until rig limit
-- column status       text   degraded or failed
-- column reason       text
-- column sessions     number
-- column rigs         number on which it happened
-- column last         time   start of the newest such session, UTC
-- column example      text   its id
SELECT s.status, coalesce(reason_class(r.value), '(no reason kept)') AS reason, count(DISTINCT s.number) AS sessions,
       count(DISTINCT s.rig) AS rigs, max(s.started_wall_ns) AS last, s.id AS example
FROM sessions s
LEFT JOIN json_each(CASE WHEN json_valid(s.reasons_json) THEN s.reasons_json ELSE '[]' END) r
WHERE s.status IN ('degraded', 'failed')
  AND s.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND s.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR s.rig = :rig)
GROUP BY s.status, reason
ORDER BY sessions DESC, s.status, reason
LIMIT coalesce(:limit, -1)
