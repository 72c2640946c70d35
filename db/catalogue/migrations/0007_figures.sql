-- Schema 7: figures of metrics.json schema 2, whose definitions changed with their names (docs/math/evaluation.md). Those of
-- earlier fits stay under their old names and are compared with no new one. Frozen once released.

-- One row a fit, with the figures asked for most: held-out stripe light of the tied model, separated direct light,
-- reconstructed geometry, mean over the held-out projectors.
DROP VIEW fit_overview;
CREATE VIEW fit_overview AS
  SELECT f.session, f.id, f.created_wall_ns,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'prediction.stripe.tied.total.separated.reconstructed.nrmse') AS nrmse,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'prediction.stripe.tied.total.separated.reconstructed.ssim') AS ssim,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id
            AND m.name = 'prediction.stripe.tied.total.separated.reconstructed.psnr_db') AS psnr_db,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id AND m.name = 'fit.divergence')
            AS divergence,
         (SELECT m.value FROM metrics m WHERE m.session = f.session AND m.fit = f.id AND m.name = 'fit.pixels') AS pixels,
         strftime('%Y-%m-%dT%H:%M:%S', f.created_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', f.created_wall_ns % 1000000000) AS created
  FROM fits f;

