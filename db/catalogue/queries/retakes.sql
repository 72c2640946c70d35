-- retakes: How many frames were shot again, and why?
-- parameters: since until rig limit
-- column rig          text
-- column cause        text   why the shot before did not count
-- column retakes      number frames shot again for it
-- column sessions     number with such a retake
-- column per_session  number mean over those sessions
-- column last         time   start of the newest of those sessions, UTC
SELECT s.rig, p.retake_cause AS cause, count(*) AS retakes, count(DISTINCT s.number) AS sessions,
       1.0 * count(*) / count(DISTINCT s.number) AS per_session, max(s.started_wall_ns) AS last
FROM sessions s CROSS JOIN proofs p INDEXED BY proofs_retakes ON p.session = s.number AND p.retake_cause <> ''
WHERE s.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND s.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR s.rig = :rig)
GROUP BY s.rig, p.retake_cause
ORDER BY retakes DESC, s.rig, cause
LIMIT coalesce(:limit, -1)
