-- sessions-per-day: How many sessions were captured each day, and how did they end?
-- parameters: since until rig limit
-- column day          text   UTC
-- column sessions     number
-- column complete     number
-- column degraded     number
-- column failed       number
-- column frames       number stored
-- column bytes        bytes  payloads
SELECT strftime('%Y-%m-%d', s.started_wall_ns / 1000000000, 'unixepoch') AS day, count(*) AS sessions,
       sum(s.status = 'complete') AS complete, sum(s.status = 'degraded') AS degraded, sum(s.status = 'failed') AS failed,
       sum(s.frame_count) AS frames, sum(s.stored_bytes) AS bytes
FROM sessions s
WHERE s.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND s.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR s.rig = :rig)
GROUP BY day
ORDER BY day DESC
LIMIT coalesce(:limit, -1)
