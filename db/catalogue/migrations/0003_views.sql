-- Schema 3: what lets operators' questions be answered without reading a million rows, and the views they start from
-- (docs/store-queries.md).

-- Which planned steps have a good frame; 12 bytes a frame.
CREATE INDEX frames_by_step ON frames (session, step, level_check);
-- Few frames are shot again: the index holds those alone.
CREATE INDEX proofs_retakes ON proofs (session, retake_cause) WHERE retake_cause <> '';
-- The newest fit of a session, without reading the kilobytes of metrics that lie before the date.
CREATE INDEX fits_by_creation ON fits (session, created_wall_ns);
DROP INDEX sessions_by_calibration;
CREATE INDEX sessions_by_calibration ON sessions (calibration_id, started_wall_ns);

-- One row a calibration. since_wall_ns: when it was made; where the record does not say, when the calibration session it
-- names started; else its first use, which makes its age the least it can be.
CREATE VIEW calibration_overview AS
  SELECT c.id, c.rig, c.source, c.made_wall_ns,
         coalesce(c.made_wall_ns,
                  (SELECT m.started_wall_ns FROM sessions m WHERE c.source = 'calibration session ' || m.id),
                  (SELECT min(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id)) AS since_wall_ns,
         (SELECT min(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id) AS first_used_wall_ns,
         (SELECT max(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id) AS last_used_wall_ns,
         (SELECT count(*) FROM sessions s WHERE s.calibration_id = c.id) AS sessions
  FROM (SELECT id, made_wall_ns,
               -- Records of schema 1 do not know their rig; the sessions do.
               coalesce(nullif(rig, ''), (SELECT s.rig FROM sessions s WHERE s.calibration_id = calibrations.id LIMIT 1), '')
                 AS rig,
               coalesce(CASE WHEN json_valid(record_json) THEN json_extract(record_json, '$.source') END, '') AS source
        FROM calibrations) c;

-- One row a fit, with the figures asked for most: held-out stripe frames of the tied model, measured direct light,
-- reconstructed geometry, mean over the held-out projectors.
CREATE VIEW fit_overview AS
  SELECT f.session, f.id, f.created_wall_ns,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'heldout.stripe.tied.total.measured.reconstructed.nrmse') AS nrmse,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'heldout.stripe.tied.total.measured.reconstructed.ssim') AS ssim,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'heldout.stripe.tied.total.measured.reconstructed.psnr_db') AS psnr_db,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id AND m.name = 'fit.divergence')
            AS divergence,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id AND m.name = 'fit.pixels') AS pixels
  FROM fits f;

-- The newest fit of each session that has one.
CREATE VIEW newest_fits AS
  SELECT number AS session, fit
  FROM (SELECT s.number, (SELECT f.id FROM fits f WHERE f.session = s.number
                          ORDER BY f.created_wall_ns DESC, f.id DESC LIMIT 1) AS fit
        FROM sessions s)
  WHERE fit IS NOT NULL;

-- One row a frame: its place and its proof together.
CREATE VIEW frame_overview AS
  SELECT f.session, f.frame, f.step, f.projector, f.phase, f.pattern, f.retry, f.level_check, f.segment, f.offset,
         f.stored_bytes, f.hash, p.bracket, p.pose, p.trigger_number, p.trigger_ns, p.sync_ns, p.driver_sequence,
         p.frame_ns, p.frame_clock, p.exposure_ms, p.gain, p.mean_dn, p.retake_cause
  FROM frames f LEFT JOIN proofs p ON p.session = f.session AND p.frame = f.frame;
