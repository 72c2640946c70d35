-- calibration-age: How old is each calibration, and who still uses it?
-- Newest use, or newest record, first. Where neither the record nor the session it names tells when it was made, its age counts from its first
-- use: it is at least that old.
-- parameters: rig limit
-- column calibration  text   id
-- column rig          text
-- column source       text   where it comes from
-- column since        time   made or first used, UTC
-- column age_days     days   now
-- column version      number of its rig, from 1; none: not made by this store's fitter
-- column valid_until  time   UTC
-- column state        text   valid, expired, or superseded by a newer version
-- column sessions     number captured with it
-- column last_used    time   start of the newest of them, UTC
-- column oldest_use   days   its age when that session started
SELECT c.id AS calibration, c.rig, c.source, c.since_wall_ns AS since,
       (:now_ns - c.since_wall_ns) / 86400e9 AS age_days, c.version, c.valid_until_wall_ns AS valid_until,
       CASE WHEN c.superseded_by IS NOT NULL THEN 'superseded by ' || substr(c.superseded_by, 1, 8)
            WHEN c.valid_until_wall_ns < :now_ns THEN 'expired'
            WHEN c.valid_until_wall_ns IS NOT NULL THEN 'valid' END AS state, c.sessions, c.last_used_wall_ns AS last_used,
       (c.last_used_wall_ns - c.since_wall_ns) / 86400e9 AS oldest_use
FROM calibration_overview c
WHERE :rig IS NULL OR c.rig = :rig
ORDER BY max(coalesce(c.last_used_wall_ns, 0), coalesce(c.since_wall_ns, 0)) DESC, c.id
LIMIT coalesce(:limit, -1)
