// SPDX-License-Identifier: Apache-2.0
#include "shared/manual/man_page.h"

#include <cctype>
#include <sstream>

namespace stratalux {
namespace {

// Text of a line: nothing of it is a request of roff.
std::string Escaped(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    if (c == '\\')
      escaped += "\\e";
    else if (c == '-')
      escaped += "\\-";  // else typeset as a hyphen, which nobody can paste into a shell
    else if (c == '`')
      escaped += "\\(ga";
    else if (c == '\'')
      escaped += "\\(aq";
    else if (c == '^')
      escaped += "\\(ha";
    else if (c == '~')
      escaped += "\\(ti";
    else
      escaped += c;
  }
  return escaped;
}

std::string Line(const std::string& text) {
  const bool is_request = !text.empty() && (text[0] == '.' || text[0] == '\'');
  return (is_request ? "\\&" : "") + Escaped(text) + "\n";
}

// An argument of a macro: no word of it is taken for another macro, no mark at its end is set apart.
std::string Argument(const std::string& text) {
  std::string quoted;
  for (const char c : Escaped(text)) quoted += c == '"' ? std::string("\\(dq") : std::string(1, c);
  return "\"\\&" + quoted + "\\&\"";
}

// "--name" as mdoc's Fl has it, which prints the first dash itself.
std::string Flag(const std::string& name) { return "Fl " + Escaped(name.substr(1)); }

// Sentences begin lines of their own, and no line is long, as mandoc asks of its input.
std::string Prose(const std::string& text) {
  constexpr size_t kLongest = 72;
  std::string page, line;
  std::istringstream words(text);
  for (std::string word; words >> word;) {
    if (!line.empty() && line.size() + word.size() > kLongest) {
      page += Line(line);
      line.clear();
    }
    line += (line.empty() ? "" : " ") + word;
    if (word.back() == '.' || word.back() == ';' || word.back() == ':') {
      page += Line(line);
      line.clear();
    }
  }
  return line.empty() ? page : page + Line(line);
}

std::string Capital(std::string text) {
  if (!text.empty()) text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
  return text;
}

std::string Item(const OptionEntry& option) {
  std::string item = ".It ";
  const std::string value = option.value.empty() ? "" : "Ar " + Argument(option.value);
  if (option.positional) return item + "Ar " + Argument(option.names[0]) + (option.repeated ? " ..." : "") + "\n";
  for (size_t i = 0; i < option.names.size(); ++i) item += (i > 0 ? " , " : "") + Flag(option.names[i]);
  if (!value.empty()) item += option.value_optional ? " Ns Op No = Ns " + value : " " + value;
  return item + (option.repeated ? " ..." : "") + "\n";
}

std::string Options(const CommandEntry& command) {
  if (command.options.empty()) return "";
  std::string page = ".Bl -tag -width Ds\n";
  for (const OptionEntry& option : command.options) page += Item(option) + Prose(Capital(option.text));
  return page + ".El\n";
}

// Lines that begin with two spaces are what somebody types; others are sentences.
std::string Footer(const std::string& footer) {
  std::string page, sentences;
  bool literal = false;
  const auto flush = [&] {
    if (!sentences.empty()) page += ".Pp\n" + Prose(sentences);
    sentences.clear();
  };
  std::istringstream lines(footer);
  for (std::string line; std::getline(lines, line);) {
    const bool typed = line.starts_with("  ");
    if (typed && !literal) {
      flush();
      page += ".Bd -literal -offset indent\n";
    }
    if (!typed && literal) page += ".Ed\n";
    literal = typed;
    if (typed)
      page += Line(line.substr(2));
    else if (line.empty())
      flush();
    else
      sentences += (sentences.empty() ? "" : " ") + line;
  }
  if (literal) page += ".Ed\n";
  flush();
  return page;
}

std::string Synopsis(const CommandEntry& program) {
  std::string page = ".Sh SYNOPSIS\n";
  for (const CommandEntry* command : AllCommands(program)) {
    if (!command->commands.empty()) continue;
    page += ".Nm\n";
    if (!command->path.empty()) page += ".Cm " + Escaped(command->path) + "\n";
    for (const OptionEntry& option : command->options) {
      if (!option.required || option.positional) continue;
      page += "." + Flag(option.names.back()) + " Ar " + Argument(option.value) + "\n";
    }
    page += ".Op Ar \"\\&options\"\n";
    for (const OptionEntry& option : command->options)
      if (option.positional)
        page += std::string(option.required ? ".Ar " : ".Op Ar ") + Argument(option.names[0]) +
                (option.repeated ? " ...\n" : "\n");
  }
  return page;
}

std::string Commands(const CommandEntry& program) {
  std::string page = ".Sh COMMANDS\n";
  for (const CommandEntry* command : AllCommands(program)) {
    if (command->path.empty()) continue;
    page += ".Ss " + Escaped(command->path) + "\n" + Prose(Capital(command->text) + ".") + Options(*command) +
            Footer(command->footer);
  }
  return page;
}

std::string Upper(std::string text) {
  for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return text;
}

}  // namespace

std::string ManPage(const CommandEntry& program, const std::string& version, const std::string& date) {
  std::string page = ".\\\" Made by `" + program.name + " manual man` from its table of options.\n";
  page += ".Dd " + date + "\n.Dt " + Upper(program.name) + " 1\n.Os Stratalux " + version + "\n";
  page += ".Sh NAME\n.Nm " + program.name + "\n.Nd " + Escaped(program.text) + "\n";
  page += Synopsis(program) + ".Sh DESCRIPTION\n" + Prose(Capital(program.text) + ".") + Options(program);
  if (!program.commands.empty()) page += Commands(program);
  if (!program.footer.empty()) {
    const std::string paragraph = ".Pp\n", footer = Footer(program.footer);
    page += ".Sh EXAMPLES\n" + (footer.starts_with(paragraph) ? footer.substr(paragraph.size()) : footer);
  }
  return page;
}

}  // namespace stratalux
