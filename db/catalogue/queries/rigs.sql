-- rigs: How is each rig doing?
-- parameters: since until limit
-- column rig              text
-- column sessions         number
-- column complete_percent number of its finished sessions
-- column last             time   start of its newest session, UTC
-- column last_status      text   how that one ended
-- column frames           number stored
-- column bytes            bytes  payloads
SELECT s.rig, count(*) AS sessions,
       round(100.0 * sum(s.status = 'complete') / nullif(sum(s.status <> 'recording'), 0), 1) AS complete_percent,
       max(s.started_wall_ns) AS last, s.status AS last_status, sum(s.frame_count) AS frames, sum(s.stored_bytes) AS bytes
FROM sessions s
WHERE s.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND s.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
GROUP BY s.rig
ORDER BY s.rig
LIMIT coalesce(:limit, -1)
