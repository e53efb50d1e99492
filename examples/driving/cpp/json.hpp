// A reader of JSON: values as a tree, numbers as the doubles that they were. It trusts its input.
#pragma once
#include <charconv>
#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

struct Json {
  enum Kind { Null, Bool, Number, Text, List, Object } kind = Null;
  bool truth = false;
  double number = 0;
  std::string text;
  std::vector<Json> list;
  std::map<std::string, Json> object;

  const Json& operator[](const char* name) const {
    static const Json none{};
    auto found = object.find(name);
    return found == object.end() ? none : found->second;
  }
  explicit operator bool() const { return kind != Null; }
  operator double() const {
    if (kind != Number) throw std::runtime_error("expected a number");
    return number;
  }
  double or_else(double value) const { return kind == Number ? number : value; }
};

class JsonReader {
 public:
  explicit JsonReader(const std::string& line) : at_(line.data()), end_(line.data() + line.size()) {}

  Json read() {
    Json value;
    switch (peek()) {
      case '{':
        value.kind = Json::Object;
        ++at_;
        while (!closes('}')) {
          std::string name = text();
          expect(':');
          value.object[name] = read();
        }
        break;
      case '[':
        value.kind = Json::List;
        ++at_;
        while (!closes(']')) value.list.push_back(read());
        break;
      case '"':
        value.kind = Json::Text;
        value.text = text();
        break;
      case 't':
      case 'f':
        value.kind = Json::Bool;
        value.truth = *at_ == 't';
        at_ += value.truth ? 4 : 5;
        break;
      case 'n':
        at_ += 4;
        break;
      default: {
        value.kind = Json::Number;
        auto [next, error] = std::from_chars(at_, end_, value.number);
        if (error != std::errc()) throw std::runtime_error("expected a number");
        at_ = next;
      }
    }
    return value;
  }

 private:
  const char *at_, *end_;

  char peek() {
    while (at_ < end_ && (*at_ == ' ' || *at_ == '\t')) ++at_;
    if (at_ == end_) throw std::runtime_error("the line ended too early");
    return *at_;
  }
  void expect(char wanted) {
    if (peek() != wanted) throw std::runtime_error(std::string("expected ") + wanted);
    ++at_;
  }
  // Returns whether a list or object ends here, and skips the comma if it does not.
  bool closes(char bracket) {
    if (peek() == ',') ++at_;
    if (peek() != bracket) return false;
    ++at_;
    return true;
  }
  std::string text() {
    expect('"');
    std::string found;
    for (; at_ < end_ && *at_ != '"'; ++at_) {
      if (*at_ == '\\') ++at_;  // \n and \u are not among the names and labels of the protocol
      found += *at_;
    }
    expect('"');
    return found;
  }
};
