// SPDX-License-Identifier: Apache-2.0
#include "shared/manual/command_table.h"

#include <algorithm>
#include <sstream>

namespace stratalux {
namespace {

// "TEXT:{png,tiff}" -> png, tiff.
std::vector<std::string> ChoicesOf(const std::string& type) {
  std::vector<std::string> choices;
  const size_t open = type.find('{');
  if (open == std::string::npos || type.back() != '}') return choices;
  std::istringstream list(type.substr(open + 1, type.size() - open - 2));
  for (std::string choice; std::getline(list, choice, ',');) choices.push_back(choice);
  return choices;
}

void Remark(std::string& text, const std::string& remark) {
  if (remark.empty()) return;
  if (!text.empty()) text += text.back() == '.' ? " " : ". ";
  text += remark;
}

// Which of `all` a set of CLI11 names, in the order of --help.
std::string NamesIn(const std::set<CLI::Option*>& some, const std::vector<const CLI::Option*>& all) {
  std::string names;
  for (const CLI::Option* option : all)
    if (some.count(const_cast<CLI::Option*>(option)) > 0)
      names += (names.empty() ? "" : ", ") + option->get_name(option->get_positional());
  return names;
}

OptionEntry EntryOf(const CLI::Option& option, const std::vector<const CLI::Option*>& all) {
  OptionEntry entry;
  entry.positional = option.get_positional() && option.get_lnames().empty() && option.get_snames().empty();
  if (entry.positional) entry.names.push_back(option.get_name(true));
  for (const std::string& name : option.get_snames()) entry.names.push_back("-" + name);
  for (const std::string& name : option.get_lnames()) entry.names.push_back("--" + name);
  entry.required = option.get_required();
  entry.text = option.get_description();
  const bool takes = option.get_type_size_max() > 0 && option.get_expected_max() > 0;
  if (takes) {
    const std::string type = option.get_type_name();
    entry.value = type.substr(0, type.find(':'));
    entry.choices = ChoicesOf(type);
    entry.value_optional = option.get_expected_min() == 0 && !entry.positional;
    entry.repeated = option.get_expected_max() > 1;
    const size_t range = type.find(" in [");
    if (!entry.choices.empty())
      Remark(entry.text, "One of: " + type.substr(type.find('{') + 1, type.size() - type.find('{') - 2));
    else if (range != std::string::npos)
      Remark(entry.text, "Range" + type.substr(range + 3));
    if (!option.get_default_str().empty()) Remark(entry.text, "Default: " + option.get_default_str());
  }
  if (!option.get_envname().empty()) Remark(entry.text, "If absent: $" + option.get_envname());
  if (entry.required) Remark(entry.text, "Required");
  if (const std::string names = NamesIn(option.get_needs(), all); !names.empty()) Remark(entry.text, "Needs " + names);
  if (const std::string names = NamesIn(option.get_excludes(), all); !names.empty())
    Remark(entry.text, "Not with " + names);
  return entry;
}

CommandEntry EntryOf(const CLI::App& app, const std::string& name, const std::string& path) {
  CommandEntry entry{name, path, app.get_description(), app.get_footer(), {}, {}};
  const std::vector<const CLI::Option*> all =
      app.get_options([](const CLI::Option* option) { return !option->get_group().empty(); });
  for (const CLI::Option* option : all) entry.options.push_back(EntryOf(*option, all));
  std::stable_partition(entry.options.begin(), entry.options.end(), [](const OptionEntry& o) { return o.positional; });
  for (const CLI::App* command : app.get_subcommands([](const CLI::App* sub) { return !sub->get_group().empty(); }))
    entry.commands.push_back(
        EntryOf(*command, command->get_name(), path + (path.empty() ? "" : " ") + command->get_name()));
  return entry;
}

void Collect(const CommandEntry& command, std::vector<const CommandEntry*>& all) {
  all.push_back(&command);
  for (const CommandEntry& below : command.commands) Collect(below, all);
}

}  // namespace

CommandEntry CommandTable(const CLI::App& app, const std::string& program) { return EntryOf(app, program, ""); }

std::vector<const CommandEntry*> AllCommands(const CommandEntry& program) {
  std::vector<const CommandEntry*> all;
  Collect(program, all);
  return all;
}

}  // namespace stratalux
