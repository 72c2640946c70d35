// SPDX-License-Identifier: Apache-2.0
#include "shared/manual/completion.h"

#include <algorithm>

namespace stratalux {
namespace {

// Each script first finds the command that the words before the cursor name: the leading words, as long as they are
// commands. "/plan/show" is its name inside the scripts; the program's own is "".
std::string PathOf(const CommandEntry& command) {
  std::string path = command.path.empty() ? "" : "/" + command.path;
  std::replace(path.begin(), path.end(), ' ', '/');
  return path;
}

// As a word in single quotes; `close` is what a quote within is written as.
std::string Quoted(const std::string& text, const std::string& close) {
  std::string quoted = "'";
  for (const char c : text) quoted += c == '\'' ? close : std::string(1, c);
  return quoted + "'";
}
std::string Quoted(const std::string& text) { return Quoted(text, "'\\''"); }

// "stratalux-rig" -> "stratalux_rig".
std::string Identifier(std::string program) {
  std::replace(program.begin(), program.end(), '-', '_');
  return program;
}

std::string Joined(const std::vector<std::string>& words, const char* between) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : between) + word;
  return text;
}

std::string CommandPaths(const CommandEntry& program, const char* between) {
  std::vector<std::string> paths;
  for (const CommandEntry* command : AllCommands(program))
    if (!command->path.empty()) paths.push_back(PathOf(*command));
  return Joined(paths, between);
}

std::string Opening(const char* comment, const CommandEntry& program, const char* shell) {
  return std::string(comment) + " Made by `" + program.name + " manual " + shell + "` from its table of options.\n";
}

// "/export --format|/export --fmt": where the word behind has `choices`, or anything.
std::string BashValues(const CommandEntry& program) {
  std::string cases, anything;
  for (const CommandEntry* command : AllCommands(program)) {
    for (const OptionEntry& option : command->options) {
      if (option.positional || option.value.empty() || option.value_optional) continue;
      std::string names;
      for (const std::string& name : option.names)
        names += (names.empty() ? "" : "|") + Quoted(PathOf(*command) + " " + name);
      if (option.choices.empty())
        anything += (anything.empty() ? "" : "|") + names;
      else
        cases += "    " + names + ")\n      COMPREPLY=($(compgen -W " + Quoted(Joined(option.choices, " ")) +
                 " -- \"$cur\"))\n      return ;;\n";
    }
  }
  if (!anything.empty()) cases += "    " + anything + ")\n      return ;;\n";
  return cases;
}

std::string BashWords(const CommandEntry& command) {
  std::vector<std::string> commands, options;
  for (const CommandEntry& below : command.commands) commands.push_back(below.name);
  for (const OptionEntry& option : command.options)
    if (!option.positional) options.insert(options.end(), option.names.begin(), option.names.end());
  return "    " + Quoted(PathOf(command)) + ")\n      commands=" + Quoted(Joined(commands, " ")) +
         "\n      options=" + Quoted(Joined(options, " ")) + " ;;\n";
}

// '[' , ']' and ':' end a description of _arguments.
std::string ZshText(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    if (c == '[' || c == ']' || c == ':' || c == '\\') escaped += '\\';
    escaped += c;
  }
  return escaped;
}

std::string ZshAction(const OptionEntry& option) {
  return option.choices.empty() ? "_files" : "(" + Joined(option.choices, " ") + ")";
}

std::string ZshArguments(const CommandEntry& command) {
  std::string lines;
  for (const OptionEntry& option : command.options) {
    if (option.positional) {
      lines += " \\\n        " + Quoted((option.repeated ? "*" : "") + std::string(":") + ZshText(option.names[0]) +
                                        ":" + ZshAction(option));
      continue;
    }
    for (const std::string& name : option.names) {
      std::string spec = (option.repeated ? "*" : "") + name;
      if (!option.value.empty() && name.starts_with("--")) spec += option.value_optional ? "=-" : "=";
      spec += "[" + ZshText(option.text) + "]";
      if (!option.value.empty())
        spec += std::string(option.value_optional ? "::" : ":") + ZshText(option.value) + ":" + ZshAction(option);
      lines += " \\\n        " + Quoted(spec);
    }
  }
  return lines;
}

std::string ZshCase(const CommandEntry& command) {
  std::string text = "    " + Quoted(PathOf(command)) + ")\n";
  if (!command.commands.empty()) {
    text += "      commands=(";
    for (const CommandEntry& below : command.commands)
      text += "\n        " + Quoted(ZshText(below.name) + ":" + below.text);
    text += ")\n      [[ $words[CURRENT] == -* ]] || { _describe command commands; return }\n";
  }
  return text + "      _arguments" + ZshArguments(command) + " ;;\n";
}

std::string FishQuoted(const std::string& text) {
  std::string escaped;
  for (const char c : text) escaped += c == '\\' ? std::string("\\\\") : std::string(1, c);
  return Quoted(escaped, "\\'");
}

std::string FishOption(const std::string& start, const OptionEntry& option) {
  std::string line = start;
  for (const std::string& name : option.names)
    line += (name.starts_with("--") ? " -l " + name.substr(2) : " -s " + name.substr(1));
  if (!option.value.empty() && !option.value_optional) line += option.choices.empty() ? " -r -F" : " -x";
  if (!option.choices.empty()) line += " -a " + FishQuoted(Joined(option.choices, " "));
  return line + " -d " + FishQuoted(option.text) + "\n";
}

}  // namespace

std::string BashCompletion(const CommandEntry& program) {
  const std::string function = "_" + Identifier(program.name);
  std::string text = Opening("#", program, "bash");
  text += function + "() {\n  local cur=${COMP_WORDS[COMP_CWORD]} prev='' at='' commands='' options='' i\n";
  text += "  COMPREPLY=()\n";
  text += "  ((COMP_CWORD > 0)) && prev=${COMP_WORDS[COMP_CWORD - 1]}\n";
  // Readline makes words of their own of "=" in --format=png.
  text += "  if [[ $cur == = ]]; then\n    cur=''\n";
  text += "  elif [[ $prev == = ]]; then\n    prev=${COMP_WORDS[COMP_CWORD - 2]}\n  fi\n";
  text += "  for ((i = 1; i < COMP_CWORD; i++)); do\n    case \"$at/${COMP_WORDS[i]}\" in\n      ";
  text += CommandPaths(program, "|") + ") at+=/${COMP_WORDS[i]} ;;\n      *) break ;;\n    esac\n  done\n";
  text += "  case \"$at $prev\" in\n" + BashValues(program) + "  esac\n  case $at in\n";
  for (const CommandEntry* command : AllCommands(program)) text += BashWords(*command);
  text += "  esac\n  if [[ $cur == -* ]]; then\n    COMPREPLY=($(compgen -W \"$options\" -- \"$cur\"))\n";
  text += "  elif [[ -n $commands ]]; then\n    COMPREPLY=($(compgen -W \"$commands\" -- \"$cur\"))\n  fi\n}\n";
  return text + "complete -o bashdefault -o default -F " + function + " " + program.name + "\n";
}

std::string ZshCompletion(const CommandEntry& program) {
  std::string text = "#compdef " + program.name + "\n" + Opening("#", program, "zsh");
  text += "local at='' i\nlocal -a commands\n";
  text += "for ((i = 2; i < CURRENT; i++)); do\n  case \"$at/$words[i]\" in\n    ";
  text += CommandPaths(program, "|") + ") at+=/$words[i] ;;\n    *) break ;;\n  esac\ndone\n";
  // _arguments counts from the command on.
  text += "shift $((i - 2)) words\n((CURRENT -= i - 2))\ncase $at in\n";
  for (const CommandEntry* command : AllCommands(program)) text += ZshCase(*command);
  return text + "esac\n";
}

std::string FishCompletion(const CommandEntry& program) {
  const std::string at = "__" + Identifier(program.name) + "_at";
  std::string text = Opening("#", program, "fish") + "function " + at + "\n  set -l words (commandline -opc)\n";
  text += "  set -e words[1]\n  set -l at ''\n  for word in $words\n    switch \"$at/$word\"\n      case ";
  text +=
      CommandPaths(program, " ") + "\n        set at \"$at/$word\"\n      case '*'\n        break\n    end\n  end\n";
  text += "  test \"$at\" = \"$argv[1]\"\nend\n";
  for (const CommandEntry* command : AllCommands(program)) {
    const std::string start = "complete -c " + program.name + " -n " + FishQuoted(at + " '" + PathOf(*command) + "'");
    for (const CommandEntry& below : command->commands)
      text += start + " -f -a " + below.name + " -d " + FishQuoted(below.text) + "\n";
    for (const OptionEntry& option : command->options)
      if (!option.positional) text += FishOption(start, option);
  }
  return text;
}

}  // namespace stratalux
