// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/mixture/em_peers.h"

#include <cmath>

#include <opencv2/ml.hpp>

namespace stratalux::bench {
namespace {

void TrainFrom(cv::ml::EM& em, const cv::Mat& samples, const fit::LayerSet& start) {
  std::vector<cv::Mat> covariances;
  for (double sigma : start.sigma_mm) covariances.emplace_back(1, 1, CV_64F, cv::Scalar(sigma * sigma));
  em.trainE(samples, cv::Mat(start.depth_mm), covariances, cv::Mat(start.weight).t());
}

}  // namespace

std::vector<double> RepeatedSamples(const Photons& photons) {
  std::vector<double> at_mm;
  for (size_t i = 0; i < photons.at.size(); ++i) {
    const long count = std::lround(photons.at[i]);
    for (long n = 0; n < count; ++n) {
      const double in_cell = (static_cast<double>(n) + 0.5) / static_cast<double>(count) - 0.5;
      at_mm.push_back(photons.first_mm + (static_cast<double>(i) + in_cell) * photons.step_mm);
    }
  }
  return at_mm;
}

fit::LayerSet OpencvEm(const Photons& photons, const fit::LayerSet& start, int layers, int sweeps) {
  std::vector<double> at_mm = RepeatedSamples(photons);
  const cv::Mat samples(static_cast<int>(at_mm.size()), 1, CV_64F, at_mm.data());
  const auto em = cv::ml::EM::create();
  em->setClustersNumber(layers);
  em->setCovarianceMatrixType(cv::ml::EM::COV_MAT_DIAGONAL);
  em->setTermCriteria({cv::TermCriteria::MAX_ITER, sweeps, 0.0});
  if (start.weight.empty())
    em->trainEM(samples);
  else
    TrainFrom(*em, samples, start);
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
