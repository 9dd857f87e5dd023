// What a car should do, from a model that `carpark_mj export RUN --from-state` wrote.
//
// g++ -std=c++17 -O2 decide.cpp -I INCLUDE libonnxruntime.so -o decide
// ./decide car.onnx < known.txt
//
// Every line of the standard input is an input of the model: its name, then its numbers
// in order. What is not given is 0, so that masks leave padding out. The action is
// printed, and how long a decision takes on one core.

#include <onnxruntime_cxx_api.h>

#include <cstdio>
#include <ctime>
#include <iostream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

using Bytes = std::vector<char>;

// Writes numbers into a tensor of floats, of 32-bit integers or of truth values.
void fill(std::istringstream& line, ONNXTensorElementDataType type, size_t size,
          Bytes& data) {
  double number;
  for (size_t k = 0; k < size && line >> number; ++k) {
    if (type == ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT)
      reinterpret_cast<float*>(data.data())[k] = static_cast<float>(number);
    else if (type == ONNX_TENSOR_ELEMENT_DATA_TYPE_INT32)
      reinterpret_cast<int32_t*>(data.data())[k] = static_cast<int32_t>(number);
    else
      data[k] = number != 0;
  }
}

int main(int count, char** arguments) {
  if (count != 2) {
    std::fprintf(stderr, "usage: %s car.onnx < known.txt\n", arguments[0]);
    return 2;
  }
  Ort::Env env;
  Ort::SessionOptions options;
  options.SetIntraOpNumThreads(1);
  Ort::Session session(env, arguments[1], options);

  std::map<std::string, std::istringstream> known;
  for (std::string text; std::getline(std::cin, text);) {
    std::istringstream line(text);
    std::string name;
    line >> name;
    known[name] = std::move(line);
  }

  Ort::AllocatorWithDefaultOptions allocator;
  auto memory = Ort::MemoryInfo::CreateCpu(OrtDeviceAllocator, OrtMemTypeCPU);
  std::vector<std::string> names;
  std::vector<Bytes> buffers;
  std::vector<Ort::Value> values;
  for (size_t k = 0; k < session.GetInputCount(); ++k) {
    names.push_back(session.GetInputNameAllocated(k, allocator).get());
    auto kind = session.GetInputTypeInfo(k);
    auto info = kind.GetTensorTypeAndShapeInfo();
    auto type = info.GetElementType();
    auto shape = info.GetShape();
    size_t width = type == ONNX_TENSOR_ELEMENT_DATA_TYPE_BOOL ? 1 : 4;
    buffers.emplace_back(info.GetElementCount() * width);
    if (auto line = known.find(names.back()); line != known.end())
      fill(line->second, type, info.GetElementCount(), buffers.back());
    values.push_back(Ort::Value::CreateTensor(memory, buffers.back().data(),
                                              buffers.back().size(), shape.data(),
                                              shape.size(), type));
  }

  std::vector<const char*> inputs;
  for (const auto& name : names) inputs.push_back(name.c_str());
  const char* output = "action";
  auto decide = [&] {
    return session.Run(Ort::RunOptions{nullptr}, inputs.data(), values.data(),
                       values.size(), &output, 1);
  };
  auto found = decide();
  auto size = found[0].GetTensorTypeAndShapeInfo().GetElementCount();
  for (size_t k = 0; k < size; ++k)
    std::printf("%.9g ", found[0].GetTensorData<float>()[k]);

  constexpr int kTimes = 1000;
  auto start = std::clock();  // of the core, whatever else the machine does
  for (int k = 0; k < kTimes; ++k) decide();
  double spent = 1e3 * static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  std::printf("\n%.3f ms a decision\n", spent / kTimes);
}
