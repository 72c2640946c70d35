// SPDX-License-Identifier: Apache-2.0
// docs/math/constants.md against the code: each row's value is the constant's, no row outlives its constant, and no
// constant of the stages is missing. How a row is read stands at the head of that page.
#include <algorithm>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>

#include "fitter/evaluation/direct_light.h"
#include "fitter/mixture/choose_prior.h"
#include "fitter/mixture/choose_sweeps.h"
#include "fitter/mixture/em_options.h"
#include "fitter/photometric/fuse_normals.h"
#include "fitter/pipeline/run_options.h"
#include "fitter/profiles/profile_em.h"
#include "fitter/reconstruction/drift.h"
#include "fitter/reconstruction/smooth_surface.h"
#include "fitter/reconstruction/triangulate.h"
#include "fitter/scattering/baselines.h"
#include "fitter/separation/separate.h"
#include "fitter/skin/skin_mask.h"
#include "fitter/srd/srd_extractor.h"
#include "fitter/structured_light/gray_decoder.h"
#include "fitter/structured_light/local_homography.h"
#include "shared/capture/plan.h"

namespace stratalux::fit {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

struct Row {
  std::string name, file, value;
  int line = 0;
};
using Place = std::pair<std::string, std::string>;  // file, constant

struct Page {
  std::vector<Row> rows;
  std::set<Place> no_choices;
  std::vector<std::string> faults;  // of its form
};

std::string Trimmed(const std::string& text) {
  const size_t first = text.find_first_not_of(' ');
  return first == std::string::npos ? "" : text.substr(first, text.find_last_not_of(' ') - first + 1);
}

std::string Unquoted(const std::string& cell) {
  return cell.size() > 2 && cell.front() == '`' && cell.back() == '`' ? cell.substr(1, cell.size() - 2) : "";
}

std::vector<std::string> CellsOf(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream rest(line.substr(1));
  for (std::string cell; std::getline(rest, cell, '|');) cells.push_back(Trimmed(cell));
  return cells;
}

void ReadRow(const std::string& line, int number, Page& page) {
  const auto cells = CellsOf(line);
  const std::string where = "line " + std::to_string(number);
  if (cells.size() != 7) return page.faults.push_back(where + " has " + std::to_string(cells.size()) + " cells, not 7");
  for (const std::string& cell : cells)
    if (cell.empty()) page.faults.push_back(where + " has an empty cell");
  if (cells[6] != "again" && cells[6] != "per visit" && cells[6] != "no")
    page.faults.push_back(where + " says of living skin: " + cells[6]);
  page.rows.push_back({Unquoted(cells[0]), Unquoted(cells[1]), cells[2], number});
}

void ReadNoChoices(const std::string& line, Page& page) {
  static const std::regex quoted("`([^`]+)`");
  std::string file;
  for (std::sregex_iterator it(line.begin(), line.end(), quoted), end; it != end; ++it) {
    const std::string text = (*it)[1];
    if (file.empty())
      file = text;
    else if (text.front() == 'k' || text.find("::") != std::string::npos)
      page.no_choices.insert({file, text});
  }
}

Page PageOf(const std::string& text) {
  Page page;
  std::istringstream lines(text);
  int number = 0;
  for (std::string line; std::getline(lines, line);) {
    ++number;
    if (line.starts_with("| `")) ReadRow(line, number, page);
    if (line.starts_with("- `")) ReadNoChoices(line, page);
  }
  return page;
}

// The numbers at the head of a value; else its first word.
struct Value {
  std::vector<double> numbers;
  std::string word;
};

Value ValueOf(const std::string& cell) {
  static const std::regex number(R"(^(-?[0-9.]+(?:e-?[0-9]+)?)(, )?)");
  Value value;
  std::smatch match;
  for (std::string rest = cell; std::regex_search(rest, match, number); rest = match.suffix()) {
    value.numbers.push_back(std::stod(match[1]));
    if (!match[2].matched) break;
  }
  if (value.numbers.empty()) value.word = cell.substr(0, cell.find(' '));
  return value;
}

// What a line of code says behind the constant's name: as far as the bracket, the statement or the initialiser goes.
std::string Initialiser(const std::string& behind) {
  static const std::regex another(R"(^, k[A-Z])");
  int depth = 0;
  for (size_t i = 0; i < behind.size(); ++i) {
    const char c = behind[i];
    depth += c == '(' || c == '{' ? 1 : c == ')' || c == '}' ? -1 : 0;
    if (depth < 0 || c == ';' || behind.compare(i, 2, "//") == 0) return behind.substr(0, i);
    if (depth == 0 && std::regex_search(behind.substr(i, 4), another)) return behind.substr(0, i);
  }
  return behind;
}

std::vector<double> NumbersOf(const std::string& code) {
  static const std::regex number(R"((^|[^A-Za-z0-9_.])(-?[0-9][0-9.]*(?:e-?[0-9]+)?))");
  std::vector<double> numbers;
  for (std::sregex_iterator it(code.begin(), code.end(), number), end; it != end; ++it)
    numbers.push_back(std::stod((*it)[2]));
  return numbers;
}

bool IsWord(char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; }

// Of each line that has the name as a word what stands behind it; of a constant or a member only where it is given its
// value.
std::vector<std::string> Behind(const std::string& code, const Row& row) {
  const size_t colons = row.name.find("::");
  const bool member = colons != std::string::npos && std::isupper(static_cast<unsigned char>(row.name[0])) != 0;
  const std::string name = member ? row.name.substr(colons + 2) : row.name;
  const bool constant = name[0] == 'k' && name.find(' ') == std::string::npos;
  std::vector<std::string> all;
  std::istringstream lines(code);
  for (std::string line; std::getline(lines, line);) {
    const size_t at = line.find(name);
    if (at == std::string::npos || (at > 0 && IsWord(line[at - 1]) && IsWord(name[0]))) continue;
    const std::string rest = line.substr(at + name.size());
    if (!rest.empty() && IsWord(rest[0]) && IsWord(name.back())) continue;
    if ((member || constant) && !rest.starts_with(" = ") && !rest.starts_with("[] = ")) continue;
    all.push_back(Initialiser(rest));
  }
  return all;
}

// Empty: the code says what the row says.
std::string FaultOf(const Row& row, const std::string& code) {
  const std::string where = "line " + std::to_string(row.line) + ": " + row.name + " of " + row.file;
  if (row.name.empty() || row.file.empty()) return where + ": name and file stand in backquotes";
  const auto behind = Behind(code, row);
  if (behind.empty()) return where + " is no longer there";
  const Value value = ValueOf(row.value);
  for (const std::string& text : behind)
    if (value.word.empty() ? NumbersOf(text) == value.numbers : text.find(value.word) != std::string::npos) return "";
  return where + " is not " + row.value + ", but" + behind.front();
}

// Numeric constants that a source defines, by name; of structs of options the members.
std::set<std::string> ConstantsOf(const std::string& code) {
  static const std::regex comment("//[^\n]*"), statement(R"(\bconstexpr\b([^;]*);)"),
      name(R"(\b(k[A-Z]\w*)(?:\[\])?(?: =\s|\{))"), options(R"(\bstruct (\w+Options) \{([\s\S]*?)\n\};)"),
      member(R"(\n  (?:double|float|int|int64_t|uint64_t|size_t) (\w+) = -?[0-9])");
  const std::string text = std::regex_replace(code, comment, "");
  std::set<std::string> names;
  for (std::sregex_iterator it(text.begin(), text.end(), statement), end; it != end; ++it) {
    const std::string body = (*it)[1];
    const size_t equals = body.find_first_of("={");
    if (equals == std::string::npos || body.find('"') != std::string::npos) continue;
    if (NumbersOf(body.substr(equals)).empty()) continue;
    for (std::sregex_iterator found(body.begin(), body.end(), name); found != end; ++found)
      if (!(*found)[1].str().ends_with("Version")) names.insert((*found)[1]);
  }
  for (std::sregex_iterator it(text.begin(), text.end(), options), end; it != end; ++it) {
    const std::string body = (*it)[2];
    for (std::sregex_iterator found(body.begin(), body.end(), member); found != end; ++found)
      names.insert((*it)[1].str() + "::" + (*found)[1].str());
  }
  return names;
}

// Places of `code` that the page lacks.
std::vector<std::string> Missing(const Page& page, const std::string& file, const std::string& code) {
  std::vector<std::string> missing;
  for (const std::string& name : ConstantsOf(code)) {
    const bool in_table = std::any_of(page.rows.begin(), page.rows.end(),
                                      [&](const Row& row) { return row.file == file && row.name == name; });
    if (!in_table && !page.no_choices.contains({file, name})) missing.push_back(file + ": " + name);
  }
  return missing;
}

std::string TextOf(const std::string& file) {
  std::ifstream in(std::string(STRATALUX_SOURCE_DIR) + "/" + file);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

const Page& OurPage() {
  static const Page page = PageOf(TextOf("docs/math/constants.md"));
  return page;
}

// Defaults and constants of headers, as the compiler has them.
std::map<std::string, double> Compiled() {
  const PlanOptions plan;
  const DecodeOptions decode;
  const LocalHomographyOptions local;
  const TriangulateOptions triangulate;
  const SmoothOptions smooth;
  const DriftOptions drift;
  const SeparationOptions separation;
  const SkinOptions skin;
  const PhotometricOptions photometric;
  const SrdOptions srd;
  const CombCycle comb;
  const EmOptions em;
  const Dipole dipole;
  return {{"PlanOptions::comb_period", plan.comb_period},
          {"PlanOptions::comb_width", plan.comb_width},
          {"PlanOptions::comb_step", plan.comb_step},
          {"PlanOptions::separation_period", plan.separation_period},
          {"PlanOptions::separation_shifts", plan.separation_shifts},
          {"CombCycle::period", comb.period},
          {"CombCycle::width", comb.width},
          {"CombCycle::step", comb.step},
          {"DecodeOptions::min_signal_sigmas", decode.min_signal_sigmas},
          {"DecodeOptions::min_signal_fraction", decode.min_signal_fraction},
          {"DecodeOptions::pair_sigma_fraction", decode.pair_sigma_fraction},
          {"DecodeOptions::bound_sigmas", decode.bound_sigmas},
          {"DecodeOptions::max_astray", decode.max_astray},
          {"DecodeOptions::max_sigma_px", decode.max_sigma_px},
          {"DecodeOptions::min_amplitude_sigmas", decode.min_amplitude_sigmas},
          {"LocalHomographyOptions::radius_px", local.radius_px},
          {"LocalHomographyOptions::inlier_px", local.inlier_px},
          {"LocalHomographyOptions::trials", local.trials},
          {"LocalHomographyOptions::min_inliers", local.min_inliers},
          {"LocalHomographyOptions::min_sites", local.min_sites},
          {"TriangulateOptions::model_sigma_px", triangulate.model_sigma_px},
          {"TriangulateOptions::robust_scale", triangulate.robust_scale},
          {"TriangulateOptions::reject_sigmas", triangulate.reject_sigmas},
          {"TriangulateOptions::iterations", triangulate.iterations},
          {"TriangulateOptions::max_relative_sigma", triangulate.max_relative_sigma},
          {"TriangulateOptions::min_sites", triangulate.min_sites},
          {"TriangulateOptions::min_component", triangulate.min_component},
          {"SmoothOptions::min_radius_quads", smooth.min_radius_quads},
          {"SmoothOptions::max_radius_quads", smooth.max_radius_quads},
          {"SmoothOptions::agreement_sigmas", smooth.agreement_sigmas},
          {"SmoothOptions::robust_scale", smooth.robust_scale},
          {"SmoothOptions::min_samples", smooth.min_samples},
          {"DriftOptions::max_shift_px", drift.max_shift_px},
          {"DriftOptions::least_of_worst", drift.least_of_worst},
          {"DriftOptions::least_on_surface", drift.least_on_surface},
          {"DriftOptions::min_points", drift.min_points},
          {"DriftOptions::max_points", drift.max_points},
          {"SeparationOptions::sinusoid_amplitude", separation.sinusoid_amplitude},
          {"SeparationOptions::min_signal_sigmas", separation.min_signal_sigmas},
          {"SeparationOptions::negative_sigmas", separation.negative_sigmas},
          {"SkinOptions::least_log_scale", skin.least_log_scale},
          {"SkinOptions::least_share_scale", skin.least_share_scale},
          {"SkinOptions::freedom", skin.freedom},
          {"SkinOptions::coupling", skin.coupling},
          {"SkinOptions::least_quads", static_cast<double>(skin.least_quads)},
          {"PhotometricOptions::relative_sigma", photometric.relative_sigma},
          {"PhotometricOptions::dependence_sigmas", photometric.dependence_sigmas},
          {"PhotometricOptions::robust_sigmas", photometric.robust_sigmas},
          {"PhotometricOptions::shadow_fraction", photometric.shadow_fraction},
          {"PhotometricOptions::highlight_cone_deg", photometric.highlight_cone_deg},
          {"PhotometricOptions::min_condition", photometric.min_condition},
          {"PhotometricOptions::negative_sigmas", photometric.negative_sigmas},
          {"PhotometricOptions::surface_sigma_rad", photometric.surface_sigma_rad},
          {"FuseOptions::window_quads", FuseOptions{}.window_quads},
          {"SrdOptions::pool", srd.pool},
          {"SrdOptions::min_cos", srd.min_cos},
          {"SrdOptions::min_signal_to_noise", srd.min_signal_to_noise},
          {"SrdOptions::energy_tolerance", srd.energy_tolerance},
          {"ScatteringModel::eta", em.scattering.eta},
          {"SurfaceReflection::roughness", em.scattering.reflection.roughness},
          {"kUnknownSurface", kUnknownSurface},
          {"kMostSurface", kMostSurface},
          {"EmOptions::layers", em.layers},
          {"LayerPrior::square_shift", em.prior.square_shift},
          {"kUsualPriorPhotons", kUsualPriorPhotons},
          {"EmOptions::max_iterations", em.max_iterations},
          {"EmOptions::refinement_iterations", em.refinement_iterations},
          {"kSweepToleranceNats", kSweepToleranceNats},
          {"kSweepPixels", static_cast<double>(kSweepPixels)},
          {"EmOptions::tolerance", em.tolerance},
          {"EmOptions::cells_per_sample", em.cells_per_sample},
          {"EmOptions::max_cell_mm", em.max_cell_mm},
          {"EmOptions::min_sigma_mm", em.min_sigma_mm},
          {"EmOptions::max_sigma_mm", em.max_sigma_mm},
          {"EmOptions::min_depth_mm", em.min_depth_mm},
          {"EmOptions::max_depth_mm", em.max_depth_mm},
          {"kSharedPrior", kSharedPrior},
          {"RunOptions::heldout", RunOptions{}.heldout},
          {"Dipole::sigma_s_prime_per_mm", dipole.sigma_s_prime_per_mm},
          {"Dipole::sigma_a_per_mm", dipole.sigma_a_per_mm},
          {"Dipole::eta", dipole.eta}};
}

TEST(Constants, EachRowSaysWhatTheCodeSays) {
  EXPECT_THAT(OurPage().faults, IsEmpty());
  EXPECT_FALSE(OurPage().rows.empty());
  std::set<Place> seen;
  for (const Row& row : OurPage().rows) {
    EXPECT_EQ(FaultOf(row, TextOf(row.file)), "");
    EXPECT_TRUE(seen.insert({row.file, row.name}).second) << row.name << " of " << row.file << " stands there twice";
  }
}

TEST(Constants, WhatIsNoChoiceIsStillThere) {
  for (const auto& [file, name] : OurPage().no_choices)
    EXPECT_TRUE(ConstantsOf(TextOf(file)).contains(name)) << name << " of " << file << " is no longer there";
}

TEST(Constants, DefaultsAreThoseThatTheCompilerHas) {
  const auto compiled = Compiled();
  std::set<std::string> listed;
  for (const Row& row : OurPage().rows) {
    const auto it = compiled.find(row.name);
    if (it == compiled.end()) continue;
    listed.insert(row.name);
    EXPECT_THAT(ValueOf(row.value).numbers, ElementsAre(it->second)) << row.name;
  }
  for (const auto& [name, value] : compiled) EXPECT_TRUE(listed.contains(name)) << name << " = " << value;
  const ScatteringModel model;
  EXPECT_EQ(model.mode, FitMode::kTied);
  EXPECT_EQ(model.shift_law, ShiftLaw::kRefracted);
  EXPECT_TRUE(model.gain_model);
  EXPECT_FALSE(EmOptions{}.background_term);
}

TEST(Constants, NoneOfTheStagesIsMissing) {
  int sources = 0;
  for (const char* folder :
       {"evaluation", "image", "mixture", "motion", "photometric", "profiles", "reconstruction", "render", "scattering",
        "sensor", "separation", "skin", "srd", "stages", "structured_light"})
    for (const auto& entry :
         std::filesystem::directory_iterator(std::string(STRATALUX_SOURCE_DIR) + "/fitter/" + folder)) {
      if (entry.path().extension() != ".h" && entry.path().extension() != ".cc") continue;
      ++sources;
      const std::string file = std::string("fitter/") + folder + "/" + entry.path().filename().string();
      EXPECT_THAT(Missing(OurPage(), file, TextOf(file)), IsEmpty())
          << "docs/math/constants.md says of each constant what it rests on, or names it under \"No choices\"";
    }
  EXPECT_GT(sources, 100);
}

// Violations planted: what the laws above rest on.
TEST(ConstantsChecker, SeesValuesThatDifferAndConstantsThatAreGone) {
  const std::string code =
      "constexpr double kA = 0.5, kB = 0.25;  // of 7\n"
      "constexpr double kGrid[] = {0.0, 1e4};\n"
      "  new Loss(2.0), &tau;\n"
      "  double depth_mm = -0.5;  // 3\n";
  const auto fault = [&](const char* name, const char* value) { return FaultOf({name, "a.cc", value, 1}, code); };
  EXPECT_EQ(fault("kA", "0.5 mm"), "");
  EXPECT_EQ(fault("kB", "0.25"), "");
  EXPECT_EQ(fault("kGrid", "0, 1e4 photons"), "");
  EXPECT_EQ(fault("Loss", "2 standard deviations"), "");
  EXPECT_EQ(fault("Options::depth_mm", "-0.5 mm"), "");
  EXPECT_THAT(fault("kA", "0.6 mm"), HasSubstr("is not 0.6 mm"));
  EXPECT_THAT(fault("kGrid", "0, 1e4, 1e6"), HasSubstr("is not"));
  EXPECT_THAT(fault("Options::depth_mm", "0.5 mm"), HasSubstr("is not"));
  EXPECT_THAT(fault("kC", "0.5"), HasSubstr("no longer there"));
  EXPECT_THAT(fault("Options::depth", "-0.5"), HasSubstr("no longer there"));
}

TEST(ConstantsChecker, SeesRowsOfAnotherFormAndConstantsThatThePageLacks) {
  const Page page = PageOf(
      "| `kA` | `a.cc` | 1 | fit | set | none | no |\n"
      "| `kB` | `a.cc` | 1 | fit | set | none |\n"
      "| `kC` | `a.cc` | 1 | fit |  | none | perhaps |\n"
      "- `a.cc`: `kD` (of `memory`), `kE`\n");
  EXPECT_THAT(page.faults, ElementsAre(HasSubstr("line 2 has 6 cells"), HasSubstr("line 3 has an empty cell"),
                                       HasSubstr("line 3 says of living skin")));
  const std::string code =
      "constexpr int kA = 1, kD = 3;\nconstexpr const char* kName = \"4\";\n  constexpr float kF = 0.5F;\n"
      "struct TryOptions {\n  int tries = 3;  // at most\n  bool wild = false;\n};\n";
  EXPECT_THAT(Missing(page, "a.cc", code), ElementsAre("a.cc: TryOptions::tries", "a.cc: kF"));
}

}  // namespace
}  // namespace stratalux::fit
