// SPDX-License-Identifier: Apache-2.0
// stratalux-skin-table: makes and checks the simulated skin's transport table; line-spread profiles by Monte Carlo.
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>

#include <CLI/CLI.hpp>
#include <unistd.h>

#include "firmware-host/simulated/skin/skin_table.h"
#include "firmware-host/simulated/skin/skin_table_check.h"
#include "firmware-host/simulated/skin/subcutis_table_check.h"
#include "firmware-host/simulated/table_tool/line_spread.h"
#include "firmware-host/simulated/table_tool/people.h"
#include "shared/base/finite_options.h"
#include "shared/base/formatted.h"
#include "shared/base/version.h"
#include "shared/manual/manual.h"

namespace stratalux::rig {
namespace {

int Report(Logger& logger, const Status& status) {
  if (!status.ok()) logger.Error(status.message());
  return status.exit_code();
}

// Found out before the photons run, not hours after.
Status CheckWritable(const std::string& out) {
  const std::filesystem::path folder = std::filesystem::absolute(out).parent_path();
  if (std::filesystem::is_directory(out)) return Status::Failed("cannot write " + out + ": it is a folder");
  if (access(folder.c_str(), W_OK) != 0) return Status::Failed("cannot write " + out + ": " + std::strerror(errno));
  return Status::Ok();
}

// Makes a table and keeps it.
template <typename Make>
int MakeTable(const std::string& out, Logger& logger, const Make& make) {
  const auto start = std::chrono::steady_clock::now();
  const auto table = make();
  if (!table.ok()) return Report(logger, table.status());
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  const Status saved = table->Save(out);
  if (saved.ok()) logger.Info(Formatted("%s: made in %.1f s, %s", out.c_str(), seconds, table->manifest().c_str()));
  return Report(logger, saved);
}

enum class TableKind { kSkin, kWax, kSubcutis };

// `made`: files of skin tables whose nodes may be taken.
int Generate(TableKind kind, const std::string& out, const SkinTableRun& run, const std::vector<double>& scatterings,
             const std::vector<std::string>& made) {
  Logger logger;
  if (const Status writable = CheckWritable(out); !writable.ok()) return Report(logger, writable);
  std::vector<SkinTable> tables;
  for (const std::string& file : made) {
    const auto table = SkinTable::Load(file);
    if (!table.ok()) return Report(logger, table.status());
    if (!table->IsOf(run))
      return Report(logger, Status::Usage(Formatted("--made %s: not made with %lld photons and seed %llu", file.c_str(),
                                                    static_cast<long long>(run.photons),
                                                    static_cast<unsigned long long>(run.seed))));
    tables.push_back(*table);
  }
  if (kind == TableKind::kSubcutis)
    return MakeTable(out, logger, [&] { return GenerateSubcutisTable(run, scatterings, logger); });
  return MakeTable(out, logger, [&] {
    return kind == TableKind::kWax ? GenerateWaxTable(run, logger)
                                   : GenerateSkinTable(run, scatterings, tables, logger);
  });
}

Status OwnSeed(uint64_t seed) {
  return Status::Usage(Formatted("--seed %llu: the table's own seed, which repeats its photons; use another",
                                 static_cast<unsigned long long>(seed)));
}

int Check(const std::string& file, const SkinColumn& column, int64_t photons, uint64_t seed) {
  Logger logger;
  const auto table = SkinTable::Load(file);
  if (!table.ok()) return Report(logger, table.status());
  if (table->nodes() == 1) return Report(logger, Status::Usage(file + ": a table of wax; check needs one of skin"));
  if (column.scattering >= std::ssize(table->scatterings()))
    return Report(logger,
                  Status::Usage(file + ": has " + std::to_string(table->scatterings().size()) +
                                " scatterings, numbered from 0; there is no " + std::to_string(column.scattering)));
  if (table->seed() == seed) return Report(logger, OwnSeed(seed));
  const auto checks = RegenerateSkinCell(*table, column, photons, seed);
  int outside = 0;
  std::printf("%8s %8s %8s %12s %12s %12s %8s\n", "melanin", "blood", "epidermis", "table", "monte carlo", "std error",
              "sigmas");
  for (size_t n = 0; n < checks.size(); ++n) {
    const double sigmas = (checks[n].table - checks[n].mean) / checks[n].standard_error;
    outside += std::abs(sigmas) <= 4.0 ? 0 : 1;
    const SkinParameters node = SkinGrid::NodeParameters(static_cast<int>(n));
    std::printf("%8g %8g %8g %12.6f %12.6f %12.6f %8.2f\n", node.melanin, node.blood, node.epidermis_mm,
                checks[n].table, checks[n].mean, checks[n].standard_error, sigmas);
  }
  return outside == 0 ? 0 : 1;
}

void PrintRingsHeader(const char* first_columns) {
  std::printf("%s all light |", first_columns);
  for (size_t k = 0; k + 1 < kCheckRingsMm.size(); ++k)
    std::printf(" %g - %g mm |", kCheckRingsMm[k], kCheckRingsMm[k + 1]);
  std::printf("\n|---|---|---|---|---|---|---|---|---|\n");
}

// All light and each ring of one colour, of which all light is returned. `missed` becomes true where the root mean
// square of one exceeds `most`.
InterpolationSummary PrintRings(const std::vector<InterpolationSample>& samples, int channel, double melanin,
                                double most, bool& missed) {
  for (int ring = -1; ring + 1 < static_cast<int>(kCheckRingsMm.size()); ++ring) {
    const InterpolationSummary s = Summarise(samples, channel, ring, melanin);
    if (s.samples == 0) {
      std::printf(" - |");
    } else {
      std::printf(" %.1f / %+.1f |", 100.0 * s.rms, 100.0 * s.largest);
    }
    missed = missed || (s.samples > 0 && !(s.rms <= most));
  }
  std::printf("\n");
  return Summarise(samples, channel, -1, melanin);
}

void PrintInterpolation(const char* what, const std::vector<InterpolationSample>& samples) {
  bool ignored = false;
  for (const double melanin : {0.16, 1.0})
    for (int c = 0; c < kSkinChannels; ++c) {
      std::printf("| %s | %s | %c |", what, melanin < 1.0 ? "<= 15 %" : "all", "RGB"[c]);
      (void)PrintRings(samples, c, melanin, 1.0, ignored);
    }
}

// Markdown: rms and largest deviation in per cent. Exit 1 where the totals of skins up to 15 % melanin miss 5 %.
int CheckBetweenNodes(const std::string& file, const SkinTableRun& run, double scattering) {
  Logger logger;
  const auto table = SkinTable::Load(file);
  if (!table.ok()) return Report(logger, table.status());
  if (table->nodes() == 1) return Report(logger, Status::Usage(file + ": a table of wax; check needs one of skin"));
  InterpolationCheckOptions options;
  if (const Status known = table->CheckScattering(scattering); !known.ok()) return Report(logger, known);
  options.photons = run.photons;
  options.seed = run.seed;
  options.threads = run.threads;
  options.scattering = scattering;
  PrintRingsHeader("| between nodes of | melanin | colour |");
  options.axes = InterpolationAxes::kAngles;
  PrintInterpolation("angles", CheckInterpolation(*table, options));
  options.axes = InterpolationAxes::kAnglesAndOptics;
  const auto samples = CheckInterpolation(*table, options);
  PrintInterpolation("angles and optics", samples);
  for (int c = 0; c < kSkinChannels; ++c) {
    const InterpolationSummary all = Summarise(samples, c, -1, 0.16);
    if (all.samples == 0)
      return Report(logger, Status::Usage(Formatted("--photons %lld: too few to measure any total to 2 %%",
                                                    static_cast<long long>(run.photons))));
    if (!(std::abs(all.largest) <= 0.05)) return 1;
  }
  return 0;
}

// Largest deviation that any light of a table of other subcutis may have, and the largest root mean square of a ring.
constexpr double kMostOfAllLight = 0.02, kMostOfARing = 0.03;

// Markdown, as CheckBetweenNodes; exit 1 where a limit is missed.
int CheckOtherSubcutis(const std::string& file, const SkinTableRun& run) {
  Logger logger;
  const auto table = SubcutisTable::Load(file);
  if (!table.ok()) return Report(logger, table.status());
  if (table->scatterings().size() < 2)
    return Report(logger, Status::Usage(file + ": has one scattering; check needs two or more"));
  if (table->seed() == run.seed) return Report(logger, OwnSeed(run.seed));
  bool missed = false;
  PrintRingsHeader("| subcutis | at | colour |");
  for (const SubcutisPlaces places : {SubcutisPlaces::kNodes, SubcutisPlaces::kBetween}) {
    const auto samples =
        CheckSubcutis(*table, {.photons = run.photons, .seed = run.seed, .threads = run.threads, .places = places});
    for (const auto& [what, depth, absorption] :
         {std::tuple{"absorbs more", false, true}, {"less deep", true, false}, {"both", true, true}}) {
      std::vector<InterpolationSample> of_kind;
      for (const InterpolationSample& s : samples)
        if ((s.skin.skin_mm != kSkinMm) == depth && (s.skin.subcutis_absorption != 1.0F) == absorption)
          of_kind.push_back(s);
      for (int c = 0; c < kSkinChannels; ++c) {
        std::printf("| %s | %s | %c |", what, places == SubcutisPlaces::kNodes ? "nodes" : "half-way", "RGB"[c]);
        const InterpolationSummary all = PrintRings(of_kind, c, 1.0, kMostOfARing, missed);
        missed = missed || all.samples == 0 || !(std::abs(all.largest) <= kMostOfAllLight);
      }
    }
  }
  return missed ? 1 : 0;
}

int Profiles(const LineSpreadOptions& options, const std::string& out) {
  Logger logger;
  if (const Status valid = options.Validate(); !valid.ok()) return Report(logger, valid);
  const std::string csv = LineSpreadCsv(options);
  if (out == "-") {
    std::cout << csv;
    return 0;
  }
  std::ofstream file(out);
  file << csv;
  file.flush();
  return Report(logger, file ? Status::Ok() : Status::Failed("cannot write " + out));
}

struct PeopleRequest {
  int people = 200, first = 0;
  uint64_t seed = kPeopleSeed;
  bool fit = false, json = false;
  std::string table, csv;
};

Population Fitted(const SkinTable& table, const PeopleRequest& request, Logger& logger) {
  const Population p = FitPopulation(table, {}, request.people, request.seed, [&](int round, double cost) {
    if (round % 10 == 0) logger.Info(Formatted("round %d: cost %.5f", round, cost));
  });
  logger.Info(
      Formatted("fitted: melanin_span = %.4f, melanin_shift = %.4f, scattering_spread = %.4f, blood_median = %.5f, "
                "blood_spread = %.4f",
                p.melanin_span, p.melanin_shift, p.scattering_spread, p.blood_median, p.blood_spread));
  return p;
}

int People(const PeopleRequest& request) {
  Logger logger;
  if (request.csv == "-" && request.json)
    return Report(logger, Status::Usage("--csv - and --json both want stdout: give --csv a file"));
  const auto table = SkinTable::Load(request.table.empty() ? SkinTable::DefaultPath() : request.table);
  if (!table.ok()) return Report(logger, table.status());
  if (table->nodes() == 1)
    return Report(logger, Status::Usage(request.table + ": a table of wax; people need one of skin"));
  for (const double scattering : {kPeopleScattering.front(), kPeopleScattering.back()})
    if (const Status known = table->CheckScattering(scattering); !known.ok()) return Report(logger, known);
  if (request.first > kMostPeople - request.people)
    return Report(logger, Status::Usage(Formatted("--first %d --people %d: people are 0 .. %d", request.first,
                                                  request.people, kMostPeople - 1)));
  const Population population = request.fit ? Fitted(*table, request, logger) : Population();
  const auto people = DrawPeople(*table, request.first, request.people, request.seed, population);
  if (!request.csv.empty() && request.csv != "-") {
    std::ofstream file(request.csv);
    file << PeopleCsv(people);
    file.flush();
    if (!file) return Report(logger, Status::Failed("cannot write " + request.csv));
  }
  if (request.csv == "-") {
    std::cout << PeopleCsv(people);
  } else {
    std::cout << (request.json ? PeopleJson(people, Summarise(people)) : PeopleText(Summarise(people)));
  }
  std::cout.flush();
  return std::cout ? 0 : 1;
}

}  // namespace

int Main(int argc, char** argv) {
  CLI::App app("Light transport of the simulated skin by Monte Carlo");
  app.footer(
      "Examples:\n"
      "  stratalux-skin-table generate --photons 1000000 --seed 1 --out skin_table.bin\n"
      "  stratalux-skin-table generate --scattering 0.5 0.74 1 --photons 3000000 --out skin_table.bin\n"
      "  stratalux-skin-table generate --subcutis --scattering 0.5 0.74 1 --photons 1500000 --out subcutis_table.bin\n"
      "  stratalux-skin-table check skin_table.bin --channel 0 --in 1 --exit 2 --azimuth 4\n"
      "  stratalux-skin-table check skin_table.bin --interpolation --photons 200000\n"
      "  stratalux-skin-table check subcutis_table.bin --subcutis --photons 100000\n"
      "  stratalux-skin-table profiles --melanin 0.03 --blood 0.004 --channel 0 --incidence -45 0 30 --out train.csv\n"
      "  stratalux-skin-table population --people 200 --csv people.csv\n"
      "  stratalux-skin-table population --fit --people 400");
  app.set_version_flag("--version", kVersion);
  app.require_subcommand(1);
  SkinTableRun run;
  std::vector<double> scatterings = {1.0};
  std::string out = "-", file;
  SkinColumn column;
  double between = 1.0;
  LineSpreadOptions profiles;

  auto* generate = app.add_subcommand("generate", "Make the whole table");
  bool wax = false, subcutis = false;
  auto* of_wax = generate->add_flag("--wax", wax, "A table for the slab of wax instead of skin");
  auto* of_subcutis = generate->add_flag(
      "--subcutis", subcutis, "Instead: how a subcutis that absorbs more or begins less deep changes the skin's light");
  of_subcutis->excludes(of_wax);
  generate
      ->add_option("--photons", run.photons,
                   "Photons for each channel, scattering and incidence bin (--subcutis: depth of the subcutis)")
      ->check(CLI::PositiveNumber);
  generate->add_option("--seed", run.seed, "Seed");
  generate->add_option("--threads", run.threads, "Threads (0: all cores)");
  generate
      ->add_option("--scattering", scatterings,
                   "The table's nodes of scattering, rising, relative to tissue samples (living skin: 0.6 to 0.7)")
      ->capture_default_str()
      ->excludes(of_wax);
  std::vector<std::string> made;
  generate->add_option("--made", made, "Tables with the same photons and seed: their scatterings are not run again")
      ->excludes(of_subcutis)
      ->excludes(of_wax);
  generate->add_option("--out", out, "File to write")->required();
  auto* check = app.add_subcommand(
      "check", "Regenerate one cell with other photons and compare; exit 1 beyond 4 standard errors");
  check->add_option("table", file, "Table file")->required();
  check->add_option("--channel", column.channel, "0 R, 1 G, 2 B")->check(CLI::Range(0, 2));
  check->add_option("--in", column.in, "Incidence bin")->check(CLI::Range(0, 4));
  check->add_option("--exit", column.out, "Exit bin")->check(CLI::Range(0, 4));
  check->add_option("--azimuth", column.azimuth, "Azimuth bin")->check(CLI::Range(0, 4));
  check->add_option("--node", column.scattering, "Node of scattering, from 0")
      ->check(CLI::Range(0, SkinGrid::kMostScatterings - 1));
  bool interpolation = false;
  check->add_flag(
      "--interpolation", interpolation,
      "Instead: the table between its nodes against fresh Monte Carlo, rms / largest deviation in per cent");
  check->add_option("--scattering", between, "With --interpolation: scattering of the skins")->capture_default_str();
  bool other_subcutis = false;
  check->add_flag(
      "--subcutis", other_subcutis,
      "Instead, of a table of other subcutis: its ratios against fresh Monte Carlo, at its nodes and half-way "
      "between them; exit 1 where all light is 2 % off or a ring 3 % (rms)");
  check->add_option("--threads", run.threads, "Threads (0: all cores)");
  check->add_option("--photons", run.photons, "Photons")->check(CLI::PositiveNumber);
  uint64_t check_seed = 1001;
  check->add_option("--seed", check_seed, "Seed; must differ from the table's")->capture_default_str();
  auto* spread = app.add_subcommand("profiles", "Line-spread profiles as CSV for `stratalux-fit profiles`");
  spread->add_option("--melanin", profiles.skin.melanin, "Melanosome fraction of the epidermis")
      ->check(CLI::Range(0.0, 1.0));
  spread->add_option("--blood", profiles.skin.blood, "Blood fraction of the dermis")->check(CLI::Range(0.0, 1.0));
  spread->add_option("--scattering", profiles.skin.scattering, "Scattering relative to tissue samples")
      ->check(CLI::Range(0.1, 3.0));
  spread
      ->add_option("--subcutis-absorption", profiles.skin.subcutis_absorption,
                   "Absorption of the subcutis, relative to the skin's baseline")
      ->check(CLI::Range(0.0, 100.0));
  spread->add_option("--skin-mm", profiles.skin.skin_mm, "Depth at which the subcutis begins, mm")
      ->check(CLI::Range(0.2, 10.0));
  spread->add_option("--channel", profiles.channel, "0 R, 1 G, 2 B")->check(CLI::Range(0, 2));
  spread->add_option("--incidence", profiles.incidence_deg, "Degrees, > 0 travels towards +u")
      ->check(CLI::Range(-85.0, 85.0));
  spread->add_option("--exit", profiles.exit_deg, "Degrees, > 0 leaves towards +u")->check(CLI::Range(-80.0, 80.0));
  spread->add_option("--slit", profiles.slit_mm, "Slit widths, mm")->check(CLI::PositiveNumber);
  spread->add_option("--step-mm", profiles.step_mm, "Step of u, mm")->check(CLI::PositiveNumber);
  spread->add_option("--half-width-mm", profiles.half_width_mm, "Largest |u|, mm")->check(CLI::PositiveNumber);
  spread->add_option("--photons", profiles.photons, "Photons for each incidence")->check(CLI::PositiveNumber);
  spread->add_option("--seed", profiles.seed, "Seed");
  spread->add_option("--out", out, "CSV file, - for stdout");
  auto* population = app.add_subcommand(
      "population",
      "The people that scenes' `person` draws from: their reflectance and scattering beside measured ones");
  PeopleRequest people;
  population->add_option("--people", people.people, "How many")->check(CLI::Range(3, 100000))->capture_default_str();
  population->add_option("--first", people.first, "The first one's number")
      ->check(CLI::Range(0, kMostPeople - 1))
      ->capture_default_str();
  population->add_option("--seed", people.seed, "Seed (a scene's people have 1)")->capture_default_str();
  population->add_option("--csv", people.csv,
                         "Also write each person's skin and reflectance, - for stdout (no table then)");
  population->add_flag("--json", people.json, "JSON instead of the text table: summary and each person");
  population->add_flag("--fit", people.fit,
                       "Fit the population to these people first, and print its numbers on stderr");
  population->add_option("--table", people.table, "Table file (default: the shipped one)");
  RangesTakeFiniteNumbers(app);
  if (const auto manual = AskedManual(app, "stratalux-skin-table", argc, argv)) {
    std::cout << *manual << std::flush;
    return std::cout ? 0 : 1;
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const TableKind kind = wax ? TableKind::kWax : subcutis ? TableKind::kSubcutis : TableKind::kSkin;
  if (generate->parsed()) return Generate(kind, out, run, scatterings, made);
  if (check->parsed()) run.seed = check_seed;
  if (check->parsed() && other_subcutis) return CheckOtherSubcutis(file, run);
  if (check->parsed() && interpolation) return CheckBetweenNodes(file, run, between);
  if (check->parsed()) return Check(file, column, run.photons, run.seed);
  if (population->parsed()) return People(people);
  return Profiles(profiles, out);
}

}  // namespace stratalux::rig

int main(int argc, char** argv) { return stratalux::rig::Main(argc, argv); }
