// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/mixture/em_peers.h"

#include <cmath>

#include <opencv2/ml.hpp>

namespace stratalux::bench {

fit::LayerSet OpencvEm(const std::vector<double>& photons, double first, double step, int layers, int sweeps) {
  std::vector<double> positions;
  // Spread over the step: many samples at one place would be a layer without width.
  for (size_t i = 0; i < photons.size(); ++i) {
    const long count = std::lround(photons[i]);
    for (long n = 0; n < count; ++n)
      positions.push_back(
          first + (static_cast<double>(i) + (static_cast<double>(n) + 0.5) / static_cast<double>(count) - 0.5) * step);
  }
  const auto em = cv::ml::EM::create();
  em->setClustersNumber(layers);
  em->setCovarianceMatrixType(cv::ml::EM::COV_MAT_DIAGONAL);
  em->setTermCriteria({cv::TermCriteria::MAX_ITER, sweeps, 0.0});
  em->trainEM(cv::Mat(static_cast<int>(positions.size()), 1, CV_64F, positions.data()));
  fit::LayerSet fitted;
  std::vector<cv::Mat> covariances;
  em->getCovs(covariances);
  for (int l = 0; l < layers; ++l) {
    fitted.weight.push_back(em->getWeights().at<double>(l));
    fitted.depth_mm.push_back(em->getMeans().at<double>(l, 0));
    fitted.sigma_mm.push_back(std::sqrt(covariances[l].at<double>(0, 0)));
  }
  return fitted;
}

}  // namespace stratalux::bench
