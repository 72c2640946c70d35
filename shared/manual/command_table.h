// SPDX-License-Identifier: Apache-2.0
// The commands and options of a program as its --help has them, read from the very tables that parse its command line.
// Manual pages and completions are made of this, so that they cannot say anything else.
#pragma once

#include <string>
#include <vector>

#include <CLI/CLI.hpp>

namespace stratalux {

struct OptionEntry {
  std::vector<std::string> names;    // "-h", "--help", all that mean it; of a positional one, its name
  std::string value;                 // what it takes, such as "TEXT"; empty: nothing
  std::vector<std::string> choices;  // that --help names as all there are; empty: anything, such as a file
  std::string text;                  // what it is for, with range, default, environment and what it excludes
  bool positional = false;
  bool value_optional = false;  // --simulate, --simulate=head
  bool repeated = false;        // may have several values
  bool required = false;
};

struct CommandEntry {
  std::string name;  // of the program, or of the word behind those above it
  std::string path;  // words behind the program's name, such as "plan show"; empty: the program
  std::string text;
  std::string footer;                // examples and notes below --help
  std::vector<OptionEntry> options;  // as --help lists them, positional ones first
  std::vector<CommandEntry> commands;
};

// `app` before it parses, `program` its name. What --help hides is left out.
[[nodiscard]] CommandEntry CommandTable(const CLI::App& app, const std::string& program);

// `program` and every command below it, each before its own: the order of --help.
[[nodiscard]] std::vector<const CommandEntry*> AllCommands(const CommandEntry& program);

}  // namespace stratalux
