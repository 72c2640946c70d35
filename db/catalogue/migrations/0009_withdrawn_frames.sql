-- Schema 9: level_check of a frame is the verdict at the end of its session. A frame of a step that the session's findings
-- withdraw (no proof, wrong pattern) may have passed when it was stored, and counted for every reader. Frozen once
-- released.
UPDATE frames SET level_check = 2
  WHERE level_check <> 2 AND session IN (SELECT number FROM sessions WHERE findings_json <> '[]')
    AND step IN (SELECT f.step FROM session_findings f
                 WHERE f.session = frames.session AND f.kind IN ('no-proof', 'wrong-pattern') AND f.step >= 0);
